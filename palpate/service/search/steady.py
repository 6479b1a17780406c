"""A search without generations: a child is bred as soon as a worker is free.

A barrier between generations lets workers idle until the slowest candidate has ended. Here
candidate ``k`` is bred from the first ``k - in_flight + 1`` results *in the order of the
journal*, so up to `in_flight` candidates may run at any moment, and the search is a function
of its seed and of that order. The parents are the best candidates so far, as many as a
population. The first candidates, and those proposed before half a population has ended, are
drawn at random.

Selection, crossover and mutation are the same as in the genetic search. The candidates depend
on the duration of each evaluation; replaying them from the journal does not.
"""

from bisect import insort
from collections.abc import Sequence

import numpy as np

from palpate.service.search.base import FloatArray, Space, Stopped
from palpate.service.search.genetic import GeneticSettings
from palpate.service.search.operators import Progress, rank_expectation, scattered_crossover
from palpate.service.search.operators import stochastic_uniform as selected
from palpate.storage.errors import InputError


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
        chosen = parents[selected(rng, rank_expectation(np.arange(len(parents)), count), count)]
        if crossed:
            chosen = scattered_crossover(rng, chosen[:1], chosen[1:])
            if not (parents == chosen).all(axis=1).any():
                return np.asarray(chosen[0])
            # A copy of a parent adds no information, so it is mutated instead.
        bests = np.array(pool.bests or [pool.best])
        progress = Progress(len(bests), self.settings.generations, bests)
        return np.asarray(self.settings.mutation(rng, chosen, self.space, progress)[0])

    def _reason_to_stop(self, candidate: int, pool: Pool) -> str | None:
        if np.isneginf(pool.best):
            return "identical volumes reached: the best score is -inf and cannot improve"
        if candidate >= self.settings.population * self.settings.generations:
            return f"all {self.settings.generations} generations are done"
        stall = self.settings.stall
        return stall.reason(np.array(pool.bests)) if stall and pool.bests else None
