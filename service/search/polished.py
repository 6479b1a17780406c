"""A genetic search whose best candidates are then fitted by derivatives."""

from collections.abc import Sequence

import numpy as np

from palpate.service.search.base import Generation, Proposal, Search, Stopped
from palpate.service.search.least_squares import LeastSquaresSearch
from palpate.service.search.space import FloatArray

# Candidates that are nearer than this part of every searched interval are one start.
SAME_START = 0.05


class PolishedSearch:
    """A `Search`: generations of a genetic search, then descents from its best few.

    The genetic part proposes what it would propose alone, to the last bit.

    Parameters
    ----------
    genetic : Search
        Proposes the generations.
    polish : LeastSquaresSearch
        Its `starts` say how many candidates are fitted.
    """

    def __init__(self, genetic: Search, polish: LeastSquaresSearch) -> None:
        self.genetic, self.polish = genetic, polish

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population or the trial points after `history`, or why there are none."""
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
        """Return the best candidates that are not alike, best first, shape (n, d)."""
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
