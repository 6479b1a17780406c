"""The genetic search of the thesis, with and without generations.

The search is equivalent to MATLAB's ``ga``. A generation produces the next as follows::

    elites       the best `elite`, unchanged and not evaluated again
    crossover    round(crossover_fraction * (population - elite)) children of two parents
    mutation     the rest, children of one parent

With the thesis' settings 84 = 2 + 66 + 16, with 148 parents.

The initial population counts as a generation: 15 generations of 84 are at most
84 * 15 = 1260 candidates, of which 84 + 14 * 82 = 1232 are evaluated. Its first candidates may be
given.

A barrier between generations lets workers idle until the slowest candidate has ended. A steady
search breeds a child as soon as a worker is free. Here candidate ``k`` is bred from the first
``k - in_flight + 1`` results *in the order of the journal*, so up to `in_flight` candidates may
run at any moment, and the search is a function of its seed and of that order. The parents are the
best candidates so far, as many as a population. The first candidates, and those proposed before
half a population has ended, are drawn at random. The candidates depend on the duration of each
evaluation; replaying them from the journal does not.
"""

import math
from bisect import insort
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.service.search.genetic_operators import (
    AdaptiveFeasible,
    BreedingProgress,
    Initial,
    Mutation,
    rank_expectation,
    scattered_crossover,
    stochastic_uniform,
    uniform_population,
)
from palpate.service.search.search_interface import FloatArray, Generation, Proposal, Space, Stopped
from palpate.service.search.stop_rules import Stall
from palpate.storage.errors import InputError


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
