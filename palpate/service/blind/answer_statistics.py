"""Statistics of answers: shares and means with intervals, calibration, counts of confusions.

For the calibration of the stated probabilities, each case makes a statement about every possible
cause: that there is no gap, that none of the effects explains it, that a certain effect acts. A
statement is true or false and has a stated probability. For relatives of effects the statements
are about families and about no gap, since it is a matter of interpretation which effect applies.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.stats import norm

from palpate.service.blind.case_truth import FAILED, GROUPS, CaseRecord
from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.verdict.verdict import NO_GAP, NONE_OF_THESE

LEVEL = 0.95
DRAWS = 2000
SEED = 0


@dataclass(frozen=True)
class Estimate:
    """A number with its interval and number of cases; None without cases."""

    value: float | None
    low: float | None
    high: float | None
    count: int


NOTHING = Estimate(None, None, None, 0)


def share(right: Sequence[bool]) -> Estimate:
    """Return the share of true values, with Wilson's interval at 95 %.

    Source: E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209.

    Examples
    --------
    >>> estimate = share([True] * 10)
    >>> estimate.value, round(estimate.low, 3), estimate.high
    (1.0, 0.722, 1.0)
    """
    n = len(right)
    if n == 0:
        return NOTHING
    z = float(norm.ppf((1 + LEVEL) / 2))
    p = sum(right) / n
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    reach = z / (1 + z**2 / n) * sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    low = 0.0 if p == 0 else middle - reach
    high = 1.0 if p == 1 else middle + reach
    return Estimate(p, low, high, n)


def mean(values: Sequence[float]) -> Estimate:
    """Return the mean, with its bootstrap interval over cases."""
    if not values:
        return NOTHING
    drawn = np.asarray(values)[_draws(len(values))].mean(axis=1)
    return _estimate(float(np.mean(values)), drawn, len(values))


def of_sums(values: FloatArray, figure: Callable[[FloatArray], FloatArray]) -> Estimate:
    """Return a function of sums over cases, with its bootstrap interval over cases.

    Parameters
    ----------
    values : ndarray, shape (n, ...)
        Contribution of each case.
    figure : callable
        Maps draws of the sums, shape (d, ...), to shape (d,).
    """
    drawn = figure(values[_draws(len(values))].sum(axis=1))
    return _estimate(float(figure(values.sum(axis=0)[None])[0]), drawn, len(values))


def median(values: Sequence[float]) -> Estimate:
    """Return the median, with its bootstrap interval over cases."""
    if not values:
        return NOTHING
    drawn = np.median(np.asarray(values)[_draws(len(values))], axis=1)
    return _estimate(float(np.median(values)), drawn, len(values))


def correlation(x: Sequence[float], y: Sequence[float]) -> Estimate:
    """Return Pearson's correlation and its bootstrap interval; None below three cases."""
    n = len(x)
    if n < 3:
        return Estimate(None, None, None, n)
    a, b = np.asarray(x, np.float64), np.asarray(y, np.float64)
    index = _draws(n)
    drawn = _pearson(a[index], b[index])
    value = float(_pearson(a[None], b[None])[0])
    if not np.isfinite(value):
        return Estimate(None, None, None, n)
    return _estimate(value, drawn[np.isfinite(drawn)], n)


def _pearson(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return Pearson's correlation of each row; NaN if a row is constant."""
    a = a - a.mean(axis=1, keepdims=True)
    b = b - b.mean(axis=1, keepdims=True)
    size = np.sqrt((a**2).sum(1) * (b**2).sum(1))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(size > 1e-15, (a * b).sum(1) / size, np.nan)


def _draws(n: int) -> np.ndarray:
    return np.random.default_rng(SEED).integers(n, size=(DRAWS, n))


def _estimate(value: float, drawn: np.ndarray, count: int) -> Estimate:
    tail = (1 - LEVEL) / 2
    low, high = (float(np.quantile(drawn, q)) for q in (tail, 1 - tail))
    return Estimate(value, low, high, count)


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


ORDER = tuple(GROUPS)
ENDS = (NONE_OF_THESE, FAILED)


@dataclass(frozen=True)
class Confusion:
    """Counts of cases.

    Parameters
    ----------
    rows : tuple of str
        Kinds of truth: nothing detectable, single effects, pairs and triples, and causes outside
        the catalogue.
    columns : tuple of str
        First effects named, and answers without an effect.
    counts : tuple of tuple of int
        One tuple for each row.
    right : frozenset of (int, int)
        Row and column of correct answers.
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    right: frozenset[tuple[int, int]]


def confusion(records: Sequence[CaseRecord]) -> Confusion:
    """Return the counts of answers by truth."""
    ranked = sorted(records, key=lambda r: (ORDER.index(r.group), true_name(r)))
    rows = tuple(dict.fromkeys(true_name(r) for r in ranked))
    answers = {said_name(r) for r in records}
    effects = [name for r in ranked for name in r.effects if name in answers]
    others = sorted(answers - set(effects) - {NO_GAP, *ENDS})
    columns = (NO_GAP, *dict.fromkeys(effects), *others, *(e for e in ENDS if e in answers))
    count = Counter((true_name(r), said_name(r)) for r in records)
    right = {(rows.index(true_name(r)), columns.index(said_name(r))) for r in records if r.right}
    counts = tuple(tuple(count[row, column] for column in columns) for row in rows)
    return Confusion(rows, columns, counts, frozenset(right))


def true_name(record: CaseRecord) -> str:
    """Return the row of a case."""
    if record.group == "single":
        return record.effects[0]
    if record.group in ("pair", "triple"):
        return " + ".join(record.effects)
    return record.kind


def said_name(record: CaseRecord) -> str:
    """Return the column of a case."""
    return record.first or record.answer
