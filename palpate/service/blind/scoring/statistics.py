"""Shares and means with their intervals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.stats import norm

from palpate.storage.values import FloatArray

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
