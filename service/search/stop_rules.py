"""Ends a search at a score or after a number of evaluations."""

from collections.abc import Sequence
from dataclasses import dataclass

from palpate.service.search.base import Generation, Proposal, Search, Stopped


@dataclass(frozen=True)
class StopRules:
    """When a search ends, whatever its strategy says.

    Parameters
    ----------
    score : float or None
        Once the best candidate has this score, as it is minimised, or less.
    evaluations : int or None
        Before a generation that would exceed this number.
    goal : str
        The score for a reader, such as ``GSF -8``.
    """

    score: float | None = None
    evaluations: int | None = None
    goal: str = ""

    def reason(self, history: Sequence[Generation], proposed: Proposal) -> str | None:
        """Return why the search ends before `proposed`; None if it goes on."""
        if not history:
            return None
        if self.score is not None and min(g.scores.min() for g in history) <= self.score:
            return f"{self.goal} is reached"
        done = sum(g.evaluated for g in history)
        if self.evaluations is not None and done + len(proposed.to_evaluate) > self.evaluations:
            return f"the next generation would exceed {self.evaluations:,} evaluations"
        return None


class StoppingSearch:
    """A `Search` that also ends by `StopRules`.

    Parameters
    ----------
    inner : Search
    rules : StopRules
    """

    def __init__(self, inner: Search, rules: StopRules) -> None:
        self.inner, self.rules = inner, rules

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population after `history`, or why there is none."""
        proposed = self.inner.propose(history)
        if isinstance(proposed, Stopped):
            return proposed
        reason = self.rules.reason(history, proposed)
        return proposed if reason is None else Stopped(reason)
