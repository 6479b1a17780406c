r"""The gap in mm: how far model and image differ beyond the noise.

The mean square that a residual has beyond its noise,

.. math:: E = \overline{r_{fit}^2} - \overline{\mathrm{noise}^2},

is without bias (`workers.diagnosis.algebra.linear_fit`), and its standard deviation s follows from

.. math:: \mathrm{Var}(r'r) = 2\,\mathrm{tr}\,D^2 + 4\,m'Dm

for a residual with mean m and covariance D. But noise alone makes E as large as s or minus s, and
a gap of 0.1 mm is smaller than that. So where it is known how much even the right model misses,
the floor, the squared gap is that of the floor and of what E has beyond chance,

.. math:: G^2 = G_0^2 + \frac{E_+^3}{E^2 + (2 s)^2},

half of E where it is twice s: a smooth form of the garrote of L. Breiman, Technometrics 37 (1995)
373. Without a floor it is the positive part of E.
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
    """Root mean square distance between model and image, noise taken off.

    Parameters
    ----------
    gap_mm : float
        The floor, if there is one, where the residual is no larger than noise.
    low_mm, high_mm : float
        Interval.
    excess_mm2 : float
        Mean square of the residual beyond its noise: may be negative, and averages rightly.
    sd_mm2 : float
        Of `excess_mm2`.
    noise_mm : float
        Root mean square of the noise of the observation.
    points : int
        Residuals that were averaged over.
    """

    gap_mm: float
    low_mm: float
    high_mm: float
    excess_mm2: float
    sd_mm2: float
    noise_mm: float
    points: int


def gap(fit: LinearFit, rows: BoolArray | None = None, floor_mm: float = 0.0) -> Gap:
    """Return the gap of a fit over some of its residuals.

    Parameters
    ----------
    fit : LinearFit
    rows : ndarray of bool, shape (judged,), optional
        A region, an interface or a state; all.
    floor_mm : float
        Gap that the calibrated model shows on images of its own for reasons that are not in
        the linearised noise, such as another mesh; added in quadrature, and to the ends of
        the interval as much of it as `floor_range` of the settings says.

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
    """Return one gap of several, each with its part of the points, maybe of different fits.

    Their errors are taken for one and the same: all share the reference scan.
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
    """Return the gap of a model that lacks an effect, beside that of the model that has it.

    Noise cancels in the difference of their squares, which is known far better than either.
    """
    beyond = credited(after.excess_mm2, after, floor_mm)
    square = float(beyond) + before.excess_mm2 - after.excess_mm2
    return _between(before, square, floor_mm)


def credited(excess_mm2: FloatArray | float, of: Gap, floor_mm: float) -> FloatArray:
    """Return what the mean square of a residual has beyond its noise and beyond chance, in mm2.

    Parameters
    ----------
    excess_mm2 : float or ndarray
    of : Gap
        Whose standard deviation and noise `excess_mm2` has.
    floor_mm : float
        Without one, the positive part of the excess is credited whole.
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
    """Return the gap with a square beyond the floor, and the interval around it."""
    least, most = SETTINGS.gap.floor_range
    reach = float(ndtri(0.5 + SETTINGS.gap.level / 2)) * _whole_sd(of, floor_mm)
    low, high = min(square_mm2, of.excess_mm2) - reach, max(square_mm2, of.excess_mm2) + reach
    ends = (square_mm2, 1.0), (low, least), (high, most)
    middle, low, high = (
        float(np.sqrt(max(0.0, value) + (part * floor_mm) ** 2)) for value, part in ends
    )
    return replace(of, gap_mm=middle, low_mm=low, high_mm=high)


def _whole_sd(of: Gap, floor_mm: float) -> float:
    """Return that of the excess; where gaps have a floor, noise is not known exactly either."""
    wrong = SETTINGS.gap.noise_variance_sd * of.noise_mm**2 if floor_mm else 0.0
    return float(np.hypot(of.sd_mm2, wrong))


def _sd_of_mean_square(r: FloatArray, D: FloatArray) -> float:
    """Return that of ``r'r / n``; unknown ``m'Dm`` follows from ``E r'Dr = m'Dm + tr D^2``."""
    spread = float(np.vdot(D, D))
    systematic = max(0.0, float(r @ D @ r) - spread)
    return float(np.sqrt(2.0 * spread + 4.0 * systematic)) / len(r)
