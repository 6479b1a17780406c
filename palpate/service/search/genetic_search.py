"""The genetic search of the thesis, with and without generations, and its operators.

The search is equivalent to MATLAB's ``ga``. A generation produces the next as follows::

    elites       the best `elite`, unchanged and not evaluated again
    crossover    round(crossover_fraction * (population - elite)) children of two parents
    mutation     the rest, children of one parent

With the thesis' settings 84 = 2 + 66 + 16, with 148 parents.

The initial population counts as a generation: 15 generations of 84 are at most
84 * 15 = 1260 candidates, of which 84 + 14 * 82 = 1232 are evaluated. Its first candidates may be
given.

The operators are functions of an explicit random generator. They follow the public description of
MATLAB's ``ga`` for a bounded problem with default options: rank scaling, stochastic uniform
selection (Baker 1987), scattered crossover. The constants of its adaptive feasible mutation are
not documented; `AdaptiveFeasible` follows the idea with constants of our own.

A barrier between generations lets workers idle until the slowest candidate has ended. A steady
search breeds a child as soon as a worker is free. Here candidate ``k`` is bred from the first
``k - in_flight + 1`` results *in the order of the journal*, so up to `in_flight` candidates may
run at any moment, and the search is a function of its seed and of that order. The parents are the
best candidates so far, as many as a population. The first candidates, and those proposed before
half a population has ended, are drawn at random. The candidates depend on the duration of each
evaluation; replaying them from the journal does not.
"""

import itertools
import math
from bisect import insort
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.service.search.search_interface import FloatArray, Generation, Proposal, Space, Stopped
from palpate.service.search.stop_rules import Stall
from palpate.storage.errors import InputError

IndexArray = NDArray[np.intp]
Initial = Callable[[np.random.Generator, int, Space], FloatArray]


@dataclass(frozen=True, eq=False)
class BreedingProgress:
    """Progress of the search when children are made.

    Parameters
    ----------
    generation : int
        Index of the generation being made; 0 is the initial population.
    generations : int
        Maximum number of populations.
    bests : ndarray, shape (generation,)
        Best score up to each finished generation.
    """

    generation: int
    generations: int
    bests: FloatArray


class Mutation(Protocol):
    """An operator that turns parents into children within the bounds."""

    def __call__(
        self,
        rng: np.random.Generator,
        parents: FloatArray,
        space: Space,
        progress: BreedingProgress,
    ) -> FloatArray:
        """Return one child (m, d) for each parent (m, d)."""
        ...


def uniform_population(rng: np.random.Generator, size: int, space: Space) -> FloatArray:
    """Draw `size` independent points, uniform in the box, shape (size, d)."""
    return space.from_unit(rng.random((size, space.dimension)))


def latin_hypercube(rng: np.random.Generator, size: int, space: Space) -> FloatArray:
    """Draw `size` points, one in each of `size` equal slices of every axis.

    References
    ----------
    McKay, Beckman and Conover, Technometrics 21 (1979) 239-245.
    """
    slices = np.tile(np.arange(size, dtype=np.float64)[:, None], (1, space.dimension))
    shuffled = rng.permuted(slices, axis=0)
    return space.from_unit((shuffled + rng.random(shuffled.shape)) / size)


def rank_expectation(ranking: IndexArray, parents: int) -> FloatArray:
    """Return the expected number of selections of each candidate.

    ``parents r^(-1/2) / sum_r r^(-1/2)`` with rank ``r = 1`` for the best. The
    spread of the scores does not matter, so neither -inf nor +inf disturbs it.

    Parameters
    ----------
    ranking : ndarray of int, shape (n,)
        Candidates from best to worst.
    parents : int
        Number of parents to select.

    Returns
    -------
    ndarray, shape (n,)
        Expectation by candidate index; sums to `parents`.

    Examples
    --------
    >>> rank_expectation(np.array([1, 0]), 2).round(3).tolist()
    [0.828, 1.172]
    """
    # The reciprocal of a square root is correctly rounded on every machine; a power is not.
    weights = 1.0 / np.sqrt(np.arange(1.0, len(ranking) + 1.0))
    expectation = np.empty(len(ranking))
    expectation[ranking] = parents * weights / weights.sum()
    return expectation


def stochastic_uniform(
    rng: np.random.Generator, expectation: FloatArray, parents: int
) -> IndexArray:
    """Select parents with evenly spaced pointers on one line, then shuffle them.

    The candidates are segments on a line, as long as their expectations; the
    pointers are one unit apart, with a single random offset. So a candidate is
    selected floor or ceil of its expectation times.

    Parameters
    ----------
    expectation : ndarray, shape (n,)
        Sums to `parents`.
    parents : int
        Number of pointers.

    Returns
    -------
    ndarray of int, shape (parents,)

    References
    ----------
    Baker, Proc. 2nd Int. Conf. on Genetic Algorithms (1987) 14-21.
    """
    ends = np.cumsum(expectation)
    ends[-1] = parents  # the exact sum, without rounding
    pointers = rng.random() + np.arange(parents)
    chosen = np.minimum(np.searchsorted(ends, pointers, side="right"), len(ends) - 1)
    return rng.permutation(chosen)


def scattered_crossover(
    rng: np.random.Generator, first: FloatArray, second: FloatArray
) -> FloatArray:
    """Take each gene of a child from either parent with even odds, shape (m, d)."""
    return np.where(rng.integers(0, 2, size=first.shape) == 0, first, second)


def reflect(unit: FloatArray) -> FloatArray:
    """Fold points back into the unit cube by reflection at its walls."""
    folded = np.mod(unit, 2.0)
    return np.where(folded > 1.0, 2.0 - folded, folded)


@dataclass(frozen=True)
class AdaptiveFeasible:
    """A step in a random direction whose length adapts to recent success.

    All lengths are fractions of the range of a parameter. The step grows after a
    generation that improved the best score and shrinks after one that did not.
    It is recomputed from the best scores each time, so nothing is stored. Steps are
    reflected at the bounds, so children never leave them.

    Parameters
    ----------
    initial, smallest, largest : float
        Initial step length and its limits, ``0 < smallest <= initial <= largest``.
    grow, shrink : float
        Factors after success and failure. The defaults are powers of two, so the
        step is free of rounding errors.

    Notes
    -----
    The defaults were chosen from seven settings by the median and the 90 % quantile
    of 30 runs of 15 and of 40 generations on the functions of
    ``tests/service/search/test_convergence.py``. They are not MATLAB's constants.
    """

    initial: float = 0.25
    smallest: float = 2.0**-10
    largest: float = 0.5
    grow: float = 2.0
    shrink: float = 0.25

    def __post_init__(self) -> None:
        if not 0 < self.smallest <= self.initial <= self.largest < np.inf:
            raise InputError(
                "Mutation steps need 0 < smallest <= initial <= largest, got "
                f"{self.smallest}, {self.initial}, {self.largest}."
            )
        if not (1 <= self.grow < np.inf and 0 < self.shrink <= 1):
            raise InputError(
                "Mutation steps need grow >= 1 and 0 < shrink <= 1, got "
                f"{self.grow} and {self.shrink}."
            )

    def step(self, bests: FloatArray) -> float:
        """Return the step length after the best scores `bests`, shape (g,), never increasing."""
        length = self.initial
        for before, after in itertools.pairwise(bests):
            if np.isposinf(before):
                continue  # that population was drawn at random, not by a step
            factor = self.grow if after < before else self.shrink
            length = min(max(length * factor, self.smallest), self.largest)
        return length

    def __call__(
        self,
        rng: np.random.Generator,
        parents: FloatArray,
        space: Space,
        progress: BreedingProgress,
    ) -> FloatArray:
        """Return children a step away from their parents, in random directions."""
        directions = rng.standard_normal(parents.shape)
        # A zero vector has probability zero; the floor prevents a division by zero.
        lengths = np.sqrt(np.sum(directions * directions, axis=1, keepdims=True))
        steps = self.step(progress.bests) * directions / np.maximum(lengths, 1e-300)
        return space.from_unit(reflect(space.to_unit(parents) + steps))


@dataclass(frozen=True)
class Gaussian:
    """Normal noise on every gene, narrower from generation to generation.

    The standard deviation is ``scale (1 - shrink g / G)`` of the range in
    generation ``g`` of ``G``. MATLAB lets such children leave the bounds; here
    they are reflected at the walls.

    Parameters
    ----------
    scale : float
        Initial standard deviation, as a fraction of the range; >= 0.
    shrink : float
        0 keeps it constant; 1 brings it towards zero in the last generation.
    """

    scale: float = 1.0
    shrink: float = 1.0

    def __post_init__(self) -> None:
        if not (0 <= self.scale < np.inf and 0 <= self.shrink <= 1):
            raise InputError(
                "Gaussian mutation needs scale >= 0 and 0 <= shrink <= 1, got "
                f"{self.scale} and {self.shrink}."
            )

    def __call__(
        self,
        rng: np.random.Generator,
        parents: FloatArray,
        space: Space,
        progress: BreedingProgress,
    ) -> FloatArray:
        """Return children with noise on every gene."""
        deviation = self.scale * (1.0 - self.shrink * progress.generation / progress.generations)
        noise = deviation * rng.standard_normal(parents.shape)
        return space.from_unit(reflect(space.to_unit(parents) + noise))


#: The names allowed in a study file; see `service.search.search_keys.SearchSpec`.
INITIAL: dict[str, Initial] = {"uniform": uniform_population, "latin-hypercube": latin_hypercube}
MUTATIONS: dict[str, Mutation] = {"adaptive-feasible": AdaptiveFeasible(), "gaussian": Gaussian()}


@dataclass(frozen=True)
class StartingAt:
    """An initial population whose first candidates are given.

    Parameters
    ----------
    points : tuple of tuple of float
        Genes, one tuple per candidate.
    others : Initial
        Draws the whole population, whose first rows the points replace.
    """

    points: tuple[tuple[float, ...], ...]
    others: Initial

    def __call__(self, rng: np.random.Generator, size: int, space: Space) -> FloatArray:
        """Return the population, shape (size, d)."""
        return with_start(self.others(rng, size, space), self.points)


def with_start(genes: FloatArray, points: Sequence[Sequence[float]]) -> FloatArray:
    """Return genes (n, d) whose first rows are the given points."""
    if not points:
        return genes
    return np.concatenate([np.asarray(points, np.float64), genes[len(points) :]])


def genes_of(points: Sequence[Mapping[str, float]], space: Space) -> tuple[tuple[float, ...], ...]:
    """Return points given by name as genes.

    Raises
    ------
    InputError
        If a point lacks a searched parameter, has an unknown one, or is out of bounds.
    """
    return tuple(_genes(number, point, space) for number, point in enumerate(points, 1))


def _genes(number: int, point: Mapping[str, float], space: Space) -> tuple[float, ...]:
    if set(point) != set(space.names):
        raise InputError(
            f"point {number} of start has {', '.join(point) or 'no values'}; expected one value "
            f"of each searched parameter: {', '.join(space.names)}"
        )
    for name, low, high in zip(space.names, space.lower, space.upper, strict=True):
        if not low <= point[name] <= high:
            raise InputError(
                f"point {number} of start: {name} {point[name]:g} is outside its bounds "
                f"[{low:g}, {high:g}]"
            )
    return tuple(float(point[name]) for name in space.names)


@dataclass(frozen=True)
class GeneticSettings:
    """Settings of the genetic search; the defaults are the thesis'.

    Parameters
    ----------
    population : int
        Candidates per generation, >= 2.
    generations : int
        Number of populations, including the initial one, >= 1.
    elite : int
        Best candidates carried over, ``0 <= elite < population``.
    crossover_fraction : float
        Share of crossover among the children that are not elite, from 0 to 1.
    stall : Stall or None
        Criterion for stopping early; ``None`` disables it.
    mutation : Mutation
        `AdaptiveFeasible` (default) or `Gaussian`.
    initial : callable
        `uniform_population` (default) or `latin_hypercube`.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    population: int = 84
    generations: int = 15
    elite: int = 2
    crossover_fraction: float = 0.8
    stall: Stall | None = field(default_factory=Stall)
    mutation: Mutation = field(default_factory=AdaptiveFeasible)
    initial: Initial = uniform_population

    def __post_init__(self) -> None:
        if self.population < 2:
            raise InputError(f"search.population must be at least 2, got {self.population}.")
        if self.generations < 1:
            raise InputError(f"search.generations must be at least 1, got {self.generations}.")
        if not 0 <= self.elite < self.population:
            raise InputError(
                f"search.elite must be from 0 to population - 1 = {self.population - 1}, "
                f"got {self.elite}: at least one candidate must be new in every generation."
            )
        if not 0 <= self.crossover_fraction <= 1:
            raise InputError(
                f"search.crossover_fraction must be in [0, 1], got {self.crossover_fraction}."
            )

    @property
    def crossover_children(self) -> int:
        """Return the number of crossover children in every generation but the first."""
        # Halves are rounded up; round() would round them to even.
        return math.floor(self.crossover_fraction * (self.population - self.elite) + 0.5)

    @property
    def mutation_children(self) -> int:
        """Return the number of mutation children in every generation but the first."""
        return self.population - self.elite - self.crossover_children

    @property
    def parents(self) -> int:
        """Return the number of parents selected for one generation."""
        return 2 * self.crossover_children + self.mutation_children

    @property
    def most_evaluations(self) -> int:
        """Return the number of evaluations if the search runs to its last generation."""
        return self.population + (self.generations - 1) * (self.population - self.elite)


class GeneticSearch:
    """A `Search` by rank selection, crossover and mutation within bounds.

    Parameters
    ----------
    space : Space
        The parameters and their bounds.
    settings : GeneticSettings
        The settings.
    seed : int
        0 <= seed < 2**32. Generation ``g`` uses only ``default_rng([seed, g])``.

    Raises
    ------
    InputError
        If the seed is out of range.

    Examples
    --------
    >>> space = Space.from_bounds({"E_fat_kpa": (5, 20)})
    >>> search = GeneticSearch(space, GeneticSettings(population=4, generations=2), seed=1)
    >>> history = []
    >>> while isinstance(proposal := search.propose(history), Proposal):
    ...     scores = {i: abs(proposal.genes[i, 0] - 10) for i in proposal.to_evaluate}
    ...     history.append(proposal.complete(scores, history))
    >>> proposal
    Stopped(reason='all 2 generations are done')
    >>> len(history), history[1].scores.min() <= history[0].scores.min()
    (2, np.True_)
    """

    def __init__(self, space: Space, settings: GeneticSettings, seed: int) -> None:
        if not 0 <= seed < 2**32:
            raise InputError(f"seed must be in [0, 2**32), got {seed}.")
        self.space = space
        self.settings = settings
        self.seed = seed

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population that follows `history`, or the reason to stop.

        Raises
        ------
        InputError
            If the history was produced by other settings or in another space.
        """
        self._check(history)
        rng = np.random.default_rng([self.seed, len(history)])
        if not history:
            return self._fresh(rng)
        bests = best_so_far(history)
        reason = self._reason_to_stop(bests)
        if reason is not None:
            return Stopped(reason)
        if np.isposinf(history[-1].scores).all():
            # All candidates failed, so there is nothing to select from.
            return self._fresh(rng)
        return self._breed(rng, history[-1], bests)

    def _fresh(self, rng: np.random.Generator) -> Proposal:
        size = self.settings.population
        return Proposal(self.settings.initial(rng, size, self.space), (None,) * size)

    def _breed(self, rng: np.random.Generator, last: Generation, bests: FloatArray) -> Proposal:
        settings = self.settings
        ranking = last.ranking
        expectation = rank_expectation(ranking, settings.parents)
        parents = last.genes[stochastic_uniform(rng, expectation, settings.parents)]
        pairs, singles = np.split(parents, [2 * settings.crossover_children])
        crossed = scattered_crossover(rng, pairs[0::2], pairs[1::2])
        progress = BreedingProgress(len(bests), settings.generations, bests)
        mutated = settings.mutation(rng, singles, self.space, progress)
        elites = ranking[: settings.elite]
        children = settings.crossover_children + settings.mutation_children
        return Proposal(
            np.concatenate([last.genes[elites], crossed, mutated]),
            (*(int(index) for index in elites), *(None,) * children),
        )

    def _reason_to_stop(self, bests: FloatArray) -> str | None:
        if np.isneginf(bests[-1]):
            return "identical volumes reached: the best score is -inf and cannot improve"
        if len(bests) >= self.settings.generations:
            return f"all {self.settings.generations} generations are done"
        return None if self.settings.stall is None else self.settings.stall.reason(bests)

    def _check(self, history: Sequence[Generation]) -> None:
        expected = (self.settings.population, self.space.dimension)
        for number, generation in enumerate(history):
            if generation.genes.shape != expected:
                raise InputError(
                    f"Generation {number} has {generation.genes.shape[0]} candidates of "
                    f"{generation.genes.shape[1]} parameters; this search makes {expected[0]} of "
                    f"{expected[1]}. The study was changed after it was started: restore its "
                    "population and parameters, or start a new study."
                )


def best_so_far(history: Sequence[Generation]) -> FloatArray:
    """Return the best score up to each generation, shape (g,), never increasing."""
    return np.minimum.accumulate([generation.scores.min() for generation in history])


class Pool:
    """The best completed candidates, as a fold over their scores.

    Parameters
    ----------
    size : int
        Number of candidates kept.

    Attributes
    ----------
    count : int
        Number of candidates added so far.
    bests : list of float
        Best score after every `size` additions.
    """

    def __init__(self, size: int) -> None:
        self.size, self.count = size, 0
        self.bests: list[float] = []
        self._ranked: list[tuple[float, int, tuple[float, ...]]] = []  # ties: earlier first

    def add(self, genes: Sequence[float], score: float) -> None:
        """Add the next candidate in the order of the journal; +inf if it failed.

        A copy of a kept candidate is ignored, or soon all would be copies of the best one.
        """
        values = tuple(map(float, genes))
        if all(values != known for _, _, known in self._ranked):
            insort(self._ranked, (score, self.count, values))
            del self._ranked[self.size :]
        self.count += 1
        if self.count % self.size == 0:
            self.bests.append(self.best)

    @property
    def best(self) -> float:
        """Return the lowest score; +inf if there is none."""
        return self._ranked[0][0] if self._ranked else np.inf

    @property
    def genes(self) -> FloatArray:
        """Return the successful candidates from best to worst, shape (n, d)."""
        return np.array([genes for score, _, genes in self._ranked if score < np.inf])


class SteadyGenetic:
    """A genetic search that proposes one candidate at a time; see the module docstring.

    Parameters
    ----------
    space : Space
    settings : GeneticSettings
        `elite` is ignored: the best candidates stay among the parents.
    seed : int
        0 <= seed < 2**32. Candidate ``k`` draws from ``default_rng([seed, k])``.
    in_flight : int
        Maximum number of concurrent candidates, at least 1.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    def __init__(self, space: Space, settings: GeneticSettings, seed: int, in_flight: int) -> None:
        if in_flight < 1:
            raise InputError(f"search.in_flight must be at least 1, got {in_flight}.")
        self.space, self.settings, self.seed, self.in_flight = space, settings, seed, in_flight
        first = np.random.default_rng([seed, 0])
        self._initial = settings.initial(first, settings.population, space)

    def known_at(self, candidate: int) -> int:
        """Return the number of results from which a candidate is bred."""
        return max(0, candidate - self.in_flight + 1)

    def propose(self, candidate: int, pool: Pool) -> FloatArray | Stopped:
        """Return the genes of a candidate, shape (d,), or the reason to stop.

        Parameters
        ----------
        candidate : int
        pool : Pool
            The pool of the first `known_at` results.
        """
        population = self.settings.population
        assert pool.count == self.known_at(candidate)
        reason = self._reason_to_stop(candidate, pool)
        if reason is not None:
            return Stopped(reason)
        if candidate < population:
            return np.asarray(self._initial[candidate])
        rng = np.random.default_rng([self.seed, candidate])
        parents = pool.genes
        if pool.count < population // 2 or len(parents) < 2:
            return np.asarray(self.space.from_unit(rng.random((1, self.space.dimension)))[0])
        return self._bred(rng, parents, pool)

    def _bred(self, rng: np.random.Generator, parents: FloatArray, pool: Pool) -> FloatArray:
        crossed = rng.random() < self.settings.crossover_fraction
        count = 2 if crossed else 1
        chosen = parents[
            stochastic_uniform(rng, rank_expectation(np.arange(len(parents)), count), count)
        ]
        if crossed:
            chosen = scattered_crossover(rng, chosen[:1], chosen[1:])
            if not (parents == chosen).all(axis=1).any():
                return np.asarray(chosen[0])
            # A copy of a parent adds no information, so it is mutated instead.
        bests = np.array(pool.bests or [pool.best])
        progress = BreedingProgress(len(bests), self.settings.generations, bests)
        return np.asarray(self.settings.mutation(rng, chosen, self.space, progress)[0])

    def _reason_to_stop(self, candidate: int, pool: Pool) -> str | None:
        if np.isneginf(pool.best):
            return "identical volumes reached: the best score is -inf and cannot improve"
        if candidate >= self.settings.population * self.settings.generations:
            return f"all {self.settings.generations} generations are done"
        stall = self.settings.stall
        return stall.reason(np.array(pool.bests)) if stall and pool.bests else None
