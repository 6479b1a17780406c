"""The search interface: a fold over the finished generations.

::

    history = []
    while isinstance(proposal := search.propose(history), Proposal):
        scores = {i: evaluate(proposal.genes[i]) for i in proposal.to_evaluate}
        history.append(proposal.complete(scores, history))

A search keeps no state between two calls. Its proposals are a function of its settings, its
seed and the history, so a study resumed from its journal continues as if it had never
stopped. A candidate is identified by its index in the generation; the order in which scores
arrive is not recorded.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.service.search.space import FloatArray, Space
from palpate.storage.errors import InputError
from palpate.storage.records.tasks import FitJson

__all__ = ["FloatArray", "Generation", "Proposal", "Search", "Space", "Stopped"]


@dataclass(frozen=True, eq=False)
class Generation:
    """A population with its scores; lower is better.

    Parameters
    ----------
    genes : ndarray, shape (n, d)
        One candidate per row, in the order of the parameter space.
    scores : ndarray, shape (n,)
        ``-inf`` for identical volumes (GSF is a logarithm), ``+inf`` for a failed
        simulation; never NaN.
    fits : tuple of FitJson or None
        The least-squares problem of each candidate, None for a failed one; empty if the
        search needs no derivatives.
    evaluated : int
        Number of candidates evaluated for it; the others were carried over.

    Raises
    ------
    InputError
        If the shapes do not fit together or a score is NaN.
    """

    genes: FloatArray
    scores: FloatArray
    fits: tuple[FitJson | None, ...] = ()
    evaluated: int = 0

    def __post_init__(self) -> None:
        genes, scores = _frozen(self.genes), _frozen(self.scores)
        if genes.ndim != 2 or len(genes) == 0 or scores.shape != (len(genes),):
            raise InputError(
                "A generation needs genes of shape (n, d) and n scores, got shapes "
                f"{genes.shape} and {scores.shape}."
            )
        if np.isnan(scores).any():
            first = int(np.flatnonzero(np.isnan(scores))[0])
            raise InputError(
                f"Candidate {first} has the score NaN, which cannot be ranked. "
                "Report a failed simulation as +inf."
            )
        object.__setattr__(self, "genes", genes)
        object.__setattr__(self, "scores", scores)

    @property
    def ranking(self) -> NDArray[np.intp]:
        """Return candidates from best to worst, shape (n,); ties stay in index order."""
        return np.argsort(self.scores, kind="stable")

    @property
    def best(self) -> int:
        """Return the index of the best candidate."""
        return int(np.argmin(self.scores))


@dataclass(frozen=True, eq=False)
class Proposal:
    """The next population.

    Parameters
    ----------
    genes : ndarray, shape (n, d)
        One candidate per row.
    carried : tuple of int or None, length n
        For an elite, its index in the previous generation, whose score is reused;
        ``None`` for a candidate that needs an evaluation.
    level : int or None
        Index of the coarser resolution used for the evaluation; None for the study's own.
    derivatives : bool
        Whether the search needs the least-squares problem of each candidate.
    """

    genes: FloatArray
    carried: tuple[int | None, ...]
    level: int | None = None
    derivatives: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "genes", _frozen(self.genes))
        if len(self.carried) != len(self.genes):
            raise InputError(
                f"A proposal of {len(self.genes)} candidates needs as many entries in "
                f"`carried`, got {len(self.carried)}."
            )

    @property
    def to_evaluate(self) -> tuple[int, ...]:
        """Return the indices of the candidates that need an evaluation."""
        return tuple(index for index, origin in enumerate(self.carried) if origin is None)

    def complete(
        self,
        scores: Mapping[int, float],
        history: Sequence[Generation],
        fits: Mapping[int, FitJson | None] | None = None,
    ) -> Generation:
        """Build a generation from the scores of the evaluated candidates.

        Parameters
        ----------
        scores : mapping of int to float
            Score by candidate index, in any order, for exactly the indices in `to_evaluate`.
        history : sequence of Generation
            Previous generations; the last one provides the carried scores.
        fits : mapping of int to FitJson or None
            Least-squares problem by candidate index, if derivatives were requested.

        Raises
        ------
        InputError
            If a candidate is missing or unknown.
        """
        expected = set(self.to_evaluate)
        if expected != set(scores):
            missing = sorted(expected - set(scores))
            unknown = sorted(set(scores) - expected)
            raise InputError(
                f"A generation is complete when {len(expected)} candidates have a score; "
                f"missing: {missing}, not requested: {unknown}."
            )
        values = [
            scores[index] if origin is None else history[-1].scores[origin]
            for index, origin in enumerate(self.carried)
        ]
        known = fits or {}
        kept = tuple(known.get(i) for i in self.to_evaluate) if self.derivatives else ()
        return Generation(self.genes, np.asarray(values, dtype=np.float64), kept, len(expected))


@dataclass(frozen=True)
class Stopped:
    """The end of a search and its reason, as text."""

    reason: str


class Search(Protocol):
    """A search strategy."""

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population that follows `history`, or the reason to stop.

        Must be pure: equal arguments give bit-identical results.
        """
        ...


def _frozen(values: FloatArray) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
