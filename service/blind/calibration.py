"""Checks whether stated probabilities come true as often as they say.

Each case makes a statement for every cause that the data could tell: that there is no gap,
that none of the effects explains it, that a certain effect acts. Statements are true or
not, and were given a probability. Relatives of effects are left out: which cause is true
of them is a matter of taste.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.blind.records import CaseRecord
from service.blind.statistics import NOTHING, Estimate, mean, share

BINS = 10


@dataclass(frozen=True)
class Bin:
    """Statements of about the same probability.

    Parameters
    ----------
    low, high : float
        Probabilities in the bin; the last one holds its upper end too.
    said : float or None
        Their mean probability.
    came_true : Estimate
        The share that was true.
    """

    low: float
    high: float
    said: float | None
    came_true: Estimate


def statements(record: CaseRecord) -> list[tuple[float, bool]]:
    """Return the probabilities that an answer stated, each with whether it came true."""
    if record.group == "relative":
        return []
    true = set(record.true_causes)
    return [(p, cause in true) for cause, p in record.probabilities.items()]


def brier(records: Sequence[CaseRecord]) -> Estimate:
    """Average over the cases the sum of (probability - truth)^2; 0 is perfect.

    Source: G. W. Brier, Monthly Weather Review 78 (1950) 1.
    """
    scored = [s for record in records if (s := statements(record))]
    return mean([sum((p - true) ** 2 for p, true in s) for s in scored])


def brier_of_base_rates(records: Sequence[CaseRecord]) -> Estimate:
    """Return the Brier score of stating for each cause its frequency in the set, every time."""
    scored = [r for r in records if statements(r)]
    if not scored:
        return NOTHING
    causes = sorted({cause for r in scored for cause in r.probabilities})
    rate = {c: float(np.mean([c in r.true_causes for r in scored])) for c in causes}
    return mean(
        [sum((rate[c] - (c in r.true_causes)) ** 2 for c in r.probabilities) for r in scored]
    )


def calibration_curve(records: Sequence[CaseRecord], bins: int = BINS) -> list[Bin]:
    """Group statements by the probability that they were given."""
    made = [s for record in records for s in statements(record)]
    number = [min(int(p * bins), bins - 1) for p, _ in made]
    out = []
    for k in range(bins):
        own = [s for s, n in zip(made, number, strict=True) if n == k]
        said = float(np.mean([p for p, _ in own])) if own else None
        out.append(Bin(k / bins, (k + 1) / bins, said, share([true for _, true in own])))
    return out
