"""When a search stops: no more improvement, a score reached, a number of evaluations.

The rules for a search that no longer improves consider the best scores ``B`` of the last ``n``
steps between generations, which takes ``n + 1`` generations:

relative (MATLAB's ``ga`` today)
    ``|B[g-n] - B[g]| / (n max(1, |B[g]|)) <= tolerance``
weighted (its documentation before R2014a, when the thesis was computed)
    ``sum_k w_k |B[g-k] - B[g-k-1]| / (max(1, |B[g-k]|) sum_k w_k) <= tolerance``
    with ``w_k = 2^-k``, ``k = 0 .. n-1``: a step counts half as much as the next one.

GSF is a logarithm. At ``-inf`` (identical volumes) no improvement is possible and the
search ends for that reason, before any rule is applied; at ``+inf`` no simulation has
succeeded yet. Neither is ever subtracted here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from palpate.service.search.search_interface import (
    FloatArray,
    Generation,
    Proposal,
    Search,
    Stopped,
)
from palpate.storage.errors import InputError

StallRule = Literal["relative", "weighted"]


@dataclass(frozen=True)
class Stall:
    """A rule that stops after some generations without a noticeable improvement.

    Parameters
    ----------
    generations : int
        Number of steps considered, >= 1. The thesis: 5.
    tolerance : float
        Largest average improvement per generation that counts as none, >= 0. The
        thesis: 1e-6.
    rule : {"relative", "weighted"}
        See the formulas in the module docstring.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    generations: int = 5
    tolerance: float = 1e-6
    rule: StallRule = "relative"

    def __post_init__(self) -> None:
        if self.generations < 1:
            raise InputError(f"stall.generations must be at least 1, got {self.generations}.")
        if not (np.isfinite(self.tolerance) and self.tolerance >= 0):
            raise InputError(f"stall.tolerance must be a finite number >= 0, got {self.tolerance}.")
        if self.rule not in get_args(StallRule):
            raise InputError(
                f"stall.rule must be one of {', '.join(get_args(StallRule))}, got {self.rule!r}."
            )

    def reason(self, bests: FloatArray) -> str | None:
        """Return the reason to stop, or None to continue.

        Parameters
        ----------
        bests : ndarray, shape (g,)
            Best score up to each generation, so never increasing.
        """
        if len(bests) <= self.generations:
            return None
        window = bests[-self.generations - 1 :]
        if np.isposinf(window[-1]):
            return (
                f"no simulation has succeeded in {len(bests)} generations; see the reasons "
                "in the status, then narrow the bounds or lower the load"
            )
        if not np.isfinite(window).all():
            return None
        change = _relative(window) if self.rule == "relative" else _weighted(window)
        if change > self.tolerance:
            return None
        return (
            f"stalled: average {self.rule} change in the best score over {self.generations} "
            f"generations is {change:.3g}, tolerance {self.tolerance:g}"
        )


def _relative(window: FloatArray) -> float:
    steps = len(window) - 1
    return float(abs(window[0] - window[-1]) / (steps * max(1.0, abs(window[-1]))))


def _weighted(window: FloatArray) -> float:
    newest_first = window[::-1]
    changes = np.abs(np.diff(newest_first)) / np.maximum(1.0, np.abs(newest_first[:-1]))
    weights = 0.5 ** np.arange(len(changes))
    return float(np.sum(weights * changes) / np.sum(weights))


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
