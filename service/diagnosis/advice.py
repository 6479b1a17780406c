"""Which further measurement would decide most of what a diagnosis leaves open."""

from itertools import combinations

from palpate.service.diagnosis.words import NOT_EFFECTS, listed, spoken, together
from palpate.workers.diagnosis.schema.plan import PlanSummary
from palpate.workers.diagnosis.schema.summary import NextAcquisition, Summary

# Measurements that are worth a line.
SHOWN = 4


def undecided(summary: Summary) -> bool:
    """Return whether several causes are left."""
    return summary.verdict == "cannot-be-told-apart"


def next_acquisitions(summary: Summary, plan: PlanSummary) -> tuple[NextAcquisition, ...]:
    """Rank the measurements that were tried in a plan, the one that decides most first.

    First counts which pairs of the suspects of the 90 % set are told apart, then how many
    effects that hide in the constants come to light, then the order of the plan.

    Parameters
    ----------
    summary : Summary
    plan : PlanSummary
        Of the same scans.
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
    """Say what one of them would decide, in a phrase.

    Examples
    --------
    >>> worth(NextAcquisition("a view", (("gravity_change", "fibre_fan"),), (), 0.62))
    'tells gravity change from fibre fan; the smallest magnitudes found become 0.62 times as large'
    """
    pairs = [f"{spoken(a)} from {spoken(b)}" for a, b in option.separates]
    words = [f"tells {listed(pairs)}"] if pairs else []
    if option.reveals:
        words.append(f"brings {together(option.reveals)} to light")
    words.append(f"the smallest magnitudes found become {option.minimum_ratio:.2f} times as large")
    return "; ".join(words)


def _suspects(summary: Summary) -> list[str]:
    return [name for name in summary.set90 if name not in NOT_EFFECTS]
