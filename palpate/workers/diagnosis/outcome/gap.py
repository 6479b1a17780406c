r"""The gap in mm: the difference between model and image in excess of the noise.

The mean square of a residual in excess of its noise,

.. math:: E = \overline{r_{fit}^2} - \overline{\mathrm{noise}^2},

is unbiased (`workers.diagnosis.algebra.linear_fit`), and its standard deviation s follows from

.. math:: \mathrm{Var}(r'r) = 2\,\mathrm{tr}\,D^2 + 4\,m'Dm

for a residual with mean m and covariance D. Noise alone makes E vary by about s, which exceeds a
gap of 0.1 mm. If the error of even the true model is known (the floor G_0), the squared gap is the
squared floor plus the part of E beyond chance,

.. math:: G^2 = G_0^2 + \frac{E_+^3}{E^2 + (2 s)^2},

whose second term is half of E if E is 2 s: a smooth form of the garrote of L. Breiman,
Technometrics 37 (1995) 373. Without a floor, G^2 is the positive part of E.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.diagnosis.algebra.linear_fit import LinearFit
from palpate.workers.diagnosis.settings.values import SETTINGS


@dataclass(frozen=True, slots=True)
class Gap:
    """Root mean square distance between model and image, with the noise subtracted.

    Parameters
    ----------
    gap_mm : float
        The gap; equal to the floor, if any, where the residual is no larger than the noise.
    low_mm, high_mm : float
        Interval of the gap.
    excess_mm2 : float
        Mean square of the residual in excess of its noise; may be negative, and can be averaged.
    sd_mm2 : float
        Standard deviation of `excess_mm2`.
    noise_mm : float
        Root mean square of the observation noise.
    points : int
        Number of residuals averaged.
    """

    gap_mm: float
    low_mm: float
    high_mm: float
    excess_mm2: float
    sd_mm2: float
    noise_mm: float
    points: int


def gap(fit: LinearFit, rows: BoolArray | None = None, floor_mm: float = 0.0) -> Gap:
    """Return the gap of a fit over a subset of its residuals.

    Parameters
    ----------
    fit : LinearFit
    rows : ndarray of bool, shape (judged,), optional
        A region, an interface or a state; all residuals by default.
    floor_mm : float
        Gap of the calibrated model on its own images, from causes outside the linearised noise,
        such as another mesh. Added in quadrature; the ends of the interval use the fractions given
        by `floor_range` in the settings.

    Raises
    ------
    InputError
        If no residual is chosen or the floor is negative.
    """
    if rows is None:
        rows = np.ones(len(fit.residual), dtype=bool)
    if not rows.any() or floor_mm < 0:
        raise InputError(
            "A gap needs some residuals and floor_mm >= 0, found "
            f"{int(rows.sum())} residuals and {floor_mm} mm."
        )
    r = fit.residual[rows]
    excess = float((r**2).mean() - fit.noise_mm2[rows].mean())
    noise_mm = float(np.sqrt(fit.observation_mm2[rows].mean()))
    D = fit.covariance if rows.all() else fit.covariance[np.ix_(rows, rows)]
    sd = _sd_of_mean_square(r, D)
    return _gap(excess, sd, noise_mm, len(r), floor_mm)


def pooled(parts: Sequence[Gap], floor_mm: float = 0.0) -> Gap:
    """Return the pooled gap of several sets of points, possibly from different fits.

    Their errors are assumed to be fully correlated, because all share the reference scan.
    """
    n = np.array([part.points for part in parts], dtype=np.float64)
    excess, sd, noise2 = (
        float(np.average(values, weights=n))
        for values in zip(
            *((part.excess_mm2, part.sd_mm2, part.noise_mm**2) for part in parts), strict=True
        )
    )
    return _gap(excess, sd, float(np.sqrt(noise2)), int(n.sum()), floor_mm)


def without_effect(before: Gap, after: Gap, floor_mm: float = 0.0) -> Gap:
    """Return the gap of a model without an effect, computed from the gap of the model with it.

    Noise cancels in the difference between their squares, so the difference is far more precise
    than either.
    """
    beyond = credited(after.excess_mm2, after, floor_mm)
    square = float(beyond) + before.excess_mm2 - after.excess_mm2
    return _between(before, square, floor_mm)


def credited(excess_mm2: FloatArray | float, of: Gap, floor_mm: float) -> FloatArray:
    """Return the part of an excess mean square that is beyond chance, in mm^2.

    Parameters
    ----------
    excess_mm2 : float or ndarray
    of : Gap
        Gap that holds the standard deviation and noise of `excess_mm2`.
    floor_mm : float
        If zero, the positive part of the excess is credited in full.
    """
    positive = np.maximum(excess_mm2, 0.0)
    if not floor_mm:
        return positive
    chance = SETTINGS.gap.chance_deviations * _whole_sd(of, floor_mm)
    return np.asarray(positive**3 / (positive**2 + chance**2))


def _gap(excess: float, sd: float, noise_mm: float, points: int, floor_mm: float) -> Gap:
    blank = Gap(0.0, 0.0, 0.0, excess, sd, noise_mm, points)
    return _between(blank, float(credited(excess, blank, floor_mm)), floor_mm)


def _between(of: Gap, square_mm2: float, floor_mm: float) -> Gap:
    """Return the gap and its interval, given the square of the gap in excess of the floor."""
    least, most = SETTINGS.gap.floor_range
    reach = float(ndtri(0.5 + SETTINGS.gap.level / 2)) * _whole_sd(of, floor_mm)
    low, high = min(square_mm2, of.excess_mm2) - reach, max(square_mm2, of.excess_mm2) + reach
    ends = (square_mm2, 1.0), (low, least), (high, most)
    middle, low, high = (
        float(np.sqrt(max(0.0, value) + (part * floor_mm) ** 2)) for value, part in ends
    )
    return replace(of, gap_mm=middle, low_mm=low, high_mm=high)


def _whole_sd(of: Gap, floor_mm: float) -> float:
    """Return the standard deviation of the excess; with a floor, the noise is uncertain too."""
    wrong = SETTINGS.gap.noise_variance_sd * of.noise_mm**2 if floor_mm else 0.0
    return float(np.hypot(of.sd_mm2, wrong))


def _sd_of_mean_square(r: FloatArray, D: FloatArray) -> float:
    """Return the standard deviation of ``r'r / n``, using ``E r'Dr = m'Dm + tr D^2`` for m'Dm."""
    spread = float(np.vdot(D, D))
    systematic = max(0.0, float(r @ D @ r) - spread)
    return float(np.sqrt(2.0 * spread + 4.0 * systematic)) / len(r)
