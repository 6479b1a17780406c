"""Searches without generations: a child is bred as soon as there is room for one more.

A barrier between generations lets workers idle until the slowest candidate has ended. Here
candidate ``k`` is bred from the first ``k - in_flight + 1`` endings *in the order in which the
journal has them*, so that up to `in_flight` candidates may be on their way at any moment, and
the search is a function of its seed and of that order. The parents are the best candidates so
far, as many as a population; the first candidates, and those that are proposed before half a
population has ended, are drawn at random.

Selection, crossover and mutation are those of the genetic search. Which candidates it proposes
depends on how long each evaluation took; repeating them from the journal does not.
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
    """The best candidates among those that have ended, as a fold over their scores.

    Parameters
    ----------
    size : int
        How many are kept.

    Attributes
    ----------
    count : int
        Endings so far.
    bests : list of float
        Best score after every `size` endings.
    """

    def __init__(self, size: int) -> None:
        self.size, self.count = size, 0
        self.bests: list[float] = []
        self._ranked: list[tuple[float, int, tuple[float, ...]]] = []  # the first of equals first

    def add(self, genes: Sequence[float], score: float) -> None:
        """Add the next ending in the order of the journal; +inf for one that failed.

        Copies of a parent are no more parents, or all would soon be copies of the best one.
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
        """Return the candidates with a score from best to worst, shape (n, d)."""
        return np.array([genes for score, _, genes in self._ranked if score < np.inf])


class SteadyGenetic:
    """Proposes one candidate after the other; see the top of this file.

    Parameters
    ----------
    space : Space
    settings : GeneticSettings
        `elite` plays no part: the best stay among the parents.
    seed : int
        0 <= seed < 2**32. Candidate ``k`` draws from ``default_rng([seed, k])``.
    in_flight : int
        Candidates on their way at once, at least 1.

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
        """Return from how many endings a candidate is bred."""
        return max(0, candidate - self.in_flight + 1)

    def propose(self, candidate: int, pool: Pool) -> FloatArray | Stopped:
        """Return the genes of a candidate, shape (d,), or why there is none.

        Parameters
        ----------
        candidate : int
        pool : Pool
            Of the first `known_at` endings.
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
            # A copy of a parent would tell nothing: it is mutated instead.
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
