"""Ranking of further measurements by how much they add to a diagnosis."""

from itertools import combinations

from palpate.service.diagnosis.words import NOT_EFFECTS, listed, spoken, together
from palpate.workers.diagnosis.schema.plan import PlanSummary
from palpate.workers.diagnosis.schema.summary import NextAcquisition, Summary

# Number of measurements to list.
SHOWN = 4


def undecided(summary: Summary) -> bool:
    """Check whether several causes remain possible."""
    return summary.verdict == "cannot-be-told-apart"


def next_acquisitions(summary: Summary, plan: PlanSummary) -> tuple[NextAcquisition, ...]:
    """Rank the measurements evaluated in a plan, the most decisive first.

    The criteria are the number of pairs in the 90 % set that are distinguished, then the number
    of absorbed effects that are revealed, then the order of the plan.

    Parameters
    ----------
    summary : Summary
    plan : PlanSummary
        Plan for the same scans.
    """
    suspects = {frozenset(p) for p in combinations(_suspects(summary), 2)}
    hidden = set(summary.absorbed)
    options = [
        NextAcquisition(
            name=one.name,
            separates=tuple(pair for pair in one.separates if frozenset(pair) in suspects),
            reveals=tuple(name for name in one.reveals if name in hidden),
            minimum_ratio=one.minimum_ratio,
        )
        for one in plan.acquisitions
    ]
    ranked = sorted(options, key=lambda one: (-len(one.separates), -len(one.reveals)))
    return tuple(ranked[:SHOWN])


def worth(option: NextAcquisition) -> str:
    """Return a phrase on what a measurement would decide.

    Examples
    --------
    >>> worth(NextAcquisition("a view", (("gravity_change", "fibre_fan"),), (), 0.62))
    'distinguishes gravity change from fibre fan; detection limits become 0.62 times as large'
    """
    pairs = [f"{spoken(a)} from {spoken(b)}" for a, b in option.separates]
    words = [f"distinguishes {listed(pairs)}"] if pairs else []
    if option.reveals:
        words.append(f"reveals {together(option.reveals)}")
    words.append(f"detection limits become {option.minimum_ratio:.2f} times as large")
    return "; ".join(words)


def _suspects(summary: Summary) -> list[str]:
    return [name for name in summary.set90 if name not in NOT_EFFECTS]
