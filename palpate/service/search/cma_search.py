"""CMA-ES, a derivative-free alternative to the genetic search (N. Hansen, arXiv:1604.00772).

The package ``cma`` does the work, on the logarithms of the parameters. Its state is rebuilt
from the past generations, so a resumed search is bit-identical.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palpate.service.search.search_interface import (
    FloatArray,
    Generation,
    LogSpace,
    Proposal,
    Space,
    Stopped,
)
from palpate.service.search.stop_rules import Stall

FIRST_SIGMA = 0.3
# CMA-ES keeps no elite: in small populations its best score can stay the same for many
# generations.
CMA_STALL_GENERATIONS = 20


@dataclass(frozen=True)
class CmaSettings:
    """Settings of CMA-ES.

    Parameters
    ----------
    population : int
        Candidates per generation, >= 2.
    generations : int
        Maximum number of generations.
    stall : Stall or None
        Criterion for stopping early.
    start : tuple of float or None
        Genes around which the first candidates are drawn. Default: the middle of the box.
    """

    population: int = 12
    generations: int = 60
    stall: Stall | None = field(default_factory=lambda: Stall(CMA_STALL_GENERATIONS))
    start: tuple[float, ...] | None = None

    @property
    def most_evaluations(self) -> int:
        """Return the number of evaluations if the search runs to its last generation."""
        return self.population * self.generations


class CmaSearch:
    """A `Search` by covariance matrix adaptation.

    Parameters
    ----------
    space : Space
    settings : CmaSettings
    seed : int
    """

    def __init__(self, space: Space, settings: CmaSettings, seed: int) -> None:
        self.space, self.settings, self.seed = space, settings, seed
        self.logs = LogSpace(space)

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population that follows `history`, or the reason to stop."""
        bests = np.minimum.accumulate([g.scores.min() for g in history]) if history else np.empty(0)
        reason = self._reason_to_stop(bests)
        if reason is not None:
            return Stopped(reason)
        strategy = self._strategy()
        unit = np.array(strategy.ask())
        for generation in history:
            strategy.tell(list(unit), _finite(generation.scores))
            unit = np.array(strategy.ask())
        genes = self.logs.genes(self.logs.point(unit))
        return Proposal(genes, (None,) * len(genes))

    def _strategy(self) -> Any:
        rng = np.random.default_rng([self.seed, 0xC3A])
        options = {
            "bounds": [0.0, 1.0],
            "popsize": self.settings.population,
            "seed": np.nan,  # or it would seed NumPy's global generator
            "randn": lambda *shape: rng.standard_normal(shape),
            "verbose": -9,
            "verb_log": 0,
        }
        import cma  # takes a second, so it is imported only when this search runs

        return cma.CMAEvolutionStrategy(self._middle(), FIRST_SIGMA, options)

    def _middle(self) -> list[float]:
        if self.settings.start is None:
            return [0.5] * self.space.dimension
        at, logs = self.logs.coordinates(np.asarray(self.settings.start)), self.logs
        return [float(x) for x in (at - logs.lower) / (logs.upper - logs.lower)]

    def _reason_to_stop(self, bests: FloatArray) -> str | None:
        if len(bests) and np.isneginf(bests[-1]):
            return "identical volumes reached: the best score is -inf and cannot improve"
        if len(bests) >= self.settings.generations:
            return f"all {self.settings.generations} generations are done"
        if not len(bests) or self.settings.stall is None:
            return None
        return self.settings.stall.reason(bests)


def _finite(scores: FloatArray) -> list[float]:
    """Return scores in which a failure is slightly worse than the worst success."""
    known = scores[np.isfinite(scores)]
    low, high = (known.min() - 1, known.max() + 1) if len(known) else (0.0, 0.0)
    return [float(v) for v in np.nan_to_num(scores, neginf=low, posinf=high)]
