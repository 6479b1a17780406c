"""Calibration of the stated probabilities.

Each case makes a statement about every possible cause: that there is no gap, that none of the
effects explains it, that a certain effect acts. A statement is true or false and has a stated
probability. For relatives of effects the statements are about families and about no gap, since
it is a matter of interpretation which effect applies.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.service.blind.scoring.statistics import NOTHING, Estimate, mean, of_sums, share
from palpate.service.blind.sealed.records import CaseRecord
from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.verdict.verdict import NO_GAP

BINS = 10
# A statement with at least this probability is sure.
SURE = 0.9
# Lower bound on the stated probability of a true statement.
LEAST = 1e-4


@dataclass(frozen=True)
class Bin:
    """Statements of similar probability.

    Parameters
    ----------
    low, high : float
        Range of probabilities; the last bin includes its upper end.
    said : float or None
        Mean stated probability.
    came_true : Estimate
        Share of true statements.
    """

    low: float
    high: float
    said: float | None
    came_true: Estimate


def statements(record: CaseRecord) -> list[tuple[float, bool]]:
    """Return the stated probabilities of an answer, each with the truth of its statement."""
    if record.group == "relative":
        of_families = record.family_probabilities.items()
        said = [(p, family in record.families) for family, p in of_families]
        return said + [(p, False) for cause, p in record.probabilities.items() if cause == NO_GAP]
    true = set(record.true_causes)
    return [(p, cause in true) for cause, p in record.probabilities.items()]


def brier(records: Sequence[CaseRecord]) -> Estimate:
    """Return the sum of (probability - truth)^2, averaged over the cases; 0 is perfect.

    Source: G. W. Brier, Monthly Weather Review 78 (1950) 1.
    """
    scored = [s for record in records if (s := statements(record))]
    return mean([sum((p - true) ** 2 for p, true in s) for s in scored])


def log_score(records: Sequence[CaseRecord]) -> Estimate:
    """Return the sum of minus log(probability of the truth), averaged over cases; 0 is perfect.

    Source: I. J. Good, J. R. Stat. Soc. B 14 (1952) 107.
    """
    scored = [s for record in records if (s := statements(record))]
    return mean([sum(-np.log(max(p if true else 1 - p, LEAST)) for p, true in s) for s in scored])


def calibration_error(records: Sequence[CaseRecord], bins: int = BINS) -> Estimate:
    """Return the expected calibration error, with the interval of a bootstrap over cases.

    This is the mean, over all statements, of the distance between the share of true statements and
    the stated probability, in bins of similar probability (M. P. Naeini, G. F. Cooper and M.
    Hauskrecht, AAAI 2015, 2901).
    """
    tables = []
    for s in filter(None, map(statements, records)):
        p, true = np.array([one[0] for one in s]), np.array([one[1] for one in s], np.float64)
        number = np.minimum((p * bins).astype(int), bins - 1)
        tables.append([np.bincount(number, w, bins) for w in (np.ones(len(s)), p, true)])
    return of_sums(np.array(tables), _error_of_sums) if tables else NOTHING


def _error_of_sums(sums: FloatArray) -> FloatArray:
    """Return the error from sums of ones, probabilities and truths by bin, (draws, 3, bins)."""
    return np.asarray(np.abs(sums[:, 1] - sums[:, 2]).sum(axis=1) / sums[:, 0].sum(axis=1))


def sure_statements(records: Sequence[CaseRecord]) -> Estimate:
    """Return the fraction of statements with a probability of 90 % or more that are true."""
    made = [s for record in records for s in statements(record)]
    return share([true for p, true in made if p >= SURE])


def brier_of_base_rates(records: Sequence[CaseRecord]) -> Estimate:
    """Return the Brier score of always stating each cause's frequency in the set."""
    scored = [r for r in records if statements(r) and r.group != "relative"]
    if not scored:
        return NOTHING
    causes = sorted({cause for r in scored for cause in r.probabilities})
    rate = {c: float(np.mean([c in r.true_causes for r in scored])) for c in causes}
    return mean(
        [sum((rate[c] - (c in r.true_causes)) ** 2 for c in r.probabilities) for r in scored]
    )


def calibration_curve(records: Sequence[CaseRecord], bins: int = BINS) -> list[Bin]:
    """Return the statements grouped by stated probability."""
    made = [s for record in records for s in statements(record)]
    number = [min(int(p * bins), bins - 1) for p, _ in made]
    out = []
    for k in range(bins):
        own = [s for s, n in zip(made, number, strict=True) if n == k]
        said = float(np.mean([p for p, _ in own])) if own else None
        out.append(Bin(k / bins, (k + 1) / bins, said, share([true for _, true in own])))
    return out
