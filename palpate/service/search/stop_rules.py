"""Rules that end a search at a score or after a number of evaluations."""

from collections.abc import Sequence
from dataclasses import dataclass

from palpate.service.search.base import Generation, Proposal, Search, Stopped


@dataclass(frozen=True)
class StopRules:
    """Limits at which a search ends, whatever its strategy.

    Parameters
    ----------
    score : float or None
        Stop once the best score, as minimised, is this or lower.
    evaluations : int or None
        Stop before a generation that would exceed this number.
    goal : str
        The score as text, such as ``GSF -8``.
    """

    score: float | None = None
    evaluations: int | None = None
    goal: str = ""

    def reason(self, history: Sequence[Generation], proposed: Proposal) -> str | None:
        """Return the reason to end before `proposed`; None to continue."""
        if not history:
            return None
        if self.score is not None and min(g.scores.min() for g in history) <= self.score:
            return f"{self.goal} is reached"
        done = sum(g.evaluated for g in history)
        if self.evaluations is not None and done + len(proposed.to_evaluate) > self.evaluations:
            return f"the next generation would exceed {self.evaluations:,} evaluations"
        return None


class StoppingSearch:
    """A `Search` that also stops by `StopRules`.

    Parameters
    ----------
    inner : Search
    rules : StopRules
    """

    def __init__(self, inner: Search, rules: StopRules) -> None:
        self.inner, self.rules = inner, rules

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population that follows `history`, or the reason to stop."""
        proposed = self.inner.propose(history)
        if isinstance(proposed, Stopped):
            return proposed
        reason = self.rules.reason(history, proposed)
        return proposed if reason is None else Stopped(reason)
