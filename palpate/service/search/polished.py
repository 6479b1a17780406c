"""A genetic search whose best candidates are refined by derivatives."""

from collections.abc import Sequence

import numpy as np

from palpate.service.search.base import Generation, Proposal, Search, Stopped
from palpate.service.search.least_squares import LeastSquaresSearch
from palpate.service.search.space import FloatArray

# Candidates closer than this fraction of every searched interval count as one start.
SAME_START = 0.05


class PolishedSearch:
    """A `Search`: a genetic search, then descents from its best few candidates.

    The genetic part is bit-identical to a genetic search on its own.

    Parameters
    ----------
    genetic : Search
        Proposes the generations.
    polish : LeastSquaresSearch
        Fits the best candidates, as many as it has `starts`.
    """

    def __init__(self, genetic: Search, polish: LeastSquaresSearch) -> None:
        self.genetic, self.polish = genetic, polish

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population or trial points that follow `history`, or the reason to stop."""
        searched = [g for g in history if not g.fits]
        fitted = [g for g in history if g.fits]
        proposed = self.genetic.propose(searched)
        if isinstance(proposed, Proposal):
            return proposed
        starts = self.best_few(searched)
        if not len(starts):
            return proposed
        polished = self.polish.propose_from(starts, fitted)
        if isinstance(polished, Proposal):
            return polished
        return Stopped(f"{proposed.reason}; {polished.reason}")

    def best_few(self, searched: Sequence[Generation]) -> FloatArray:
        """Return the best distinct candidates, best first, shape (n, d)."""
        genes = np.concatenate([g.genes for g in searched])
        scores = np.concatenate([g.scores for g in searched])
        space, few = self.polish.space, self.polish.settings.starts
        chosen: list[FloatArray] = []
        for i in np.argsort(scores, kind="stable"):
            if len(chosen) == few or np.isposinf(scores[i]):
                break
            apart = [np.abs(genes[i] - other) / space.span for other in chosen]
            if all(float(a.max()) > SAME_START for a in apart):
                chosen.append(genes[i])
        return np.array(chosen).reshape(-1, space.dimension)
