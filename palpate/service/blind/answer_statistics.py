"""Statistics of answers: shares and means with intervals, reliability, counts of confusions."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.stats import norm

from palpate.service.blind.case_truth import FAILED, GROUPS, CaseRecord
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.verdict.cause_selection import NO_GAP, NONE_OF_THESE

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


def median(values: Sequence[float]) -> Estimate:
    """Return the median, with its bootstrap interval over cases."""
    if not values:
        return NOTHING
    drawn = np.median(np.asarray(values)[_draws(len(values))], axis=1)
    return _estimate(float(np.median(values)), drawn, len(values))


def _draws(n: int) -> np.ndarray:
    return np.random.default_rng(SEED).integers(n, size=(DRAWS, n))


def _estimate(value: float, drawn: np.ndarray, count: int) -> Estimate:
    tail = (1 - LEVEL) / 2
    low, high = (float(np.quantile(drawn, q)) for q in (tail, 1 - tail))
    return Estimate(value, low, high, count)


# Limits of the bands of gain, in nats; the first is the least gain of a named effect.
BANDS = (SETTINGS.selection.first, 20.0, 50.0)


@dataclass(frozen=True)
class Band:
    """Diagnoses whose first named effect gains about as much.

    Parameters
    ----------
    above, up_to : float, float or None
        Range of gains, in nats; the last band has no upper limit.
    named : Estimate
        Share of certain diagnoses whose first effect acts.
    unsure : Estimate
        The same for undecided answers: share in which one of the rivals acts.
    """

    above: float
    up_to: float | None
    named: Estimate
    unsure: Estimate


def reliability(records: Sequence[CaseRecord]) -> list[Band]:
    """Return how often the first named effect is right, by its gain."""
    bands = []
    for above, up_to in zip(BANDS, (*BANDS[1:], None), strict=True):
        own = [r for r in records if r.primary and r.gain is not None and r.gain > above]
        own = [r for r in own if up_to is None or (r.gain or 0.0) <= up_to]
        named = share([r.right_first for r in own if r.named])
        unsure = share([r.right_among(r.rivals) for r in own if not r.named])
        bands.append(Band(above, up_to, named, unsure))
    return bands


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
        Row and column of answers that are all correct.
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
    places = [(rows.index(true_name(r)), columns.index(said_name(r))) for r in records]
    wrong = {place for r, place in zip(records, places, strict=True) if not r.right}
    counts = tuple(tuple(count[row, column] for column in columns) for row in rows)
    return Confusion(rows, columns, counts, frozenset(places) - wrong)


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
