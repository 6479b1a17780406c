r"""How much of the gap an effect takes away: ``1 - G_with^2 / G_nominal^2``.

The interval is a parametric bootstrap in the linearised model. Its truth is what the
fits found: the systematic part of the residual with the effect, scaled to the size that
its gap has, plus what the effect changed. Noise of covariance C is drawn around it, both
models are fitted again, and the shares of all draws are ranked. It is a little wide for the
share of one image, which moves along with its estimate.

Fitted to some states and judged by the others, the same number is the held-out share.
"""

from dataclasses import dataclass

import numpy as np

from storage.errors import InputError
from storage.values import BoolArray, FloatArray
from workers.diagnosis.gap import LEVEL, Gap, LinearFit, gap
from workers.diagnosis.linear import Linearised

DRAWS = 400


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """Share of the squared gap that an effect removes.

    Parameters
    ----------
    share : float
        At most 1, negative where the effect makes the gap larger; nan without a gap.
    low, high : float
        Interval; nan without a gap.
    before, after : Gap
        Without and with the effect.
    """

    share: float
    low: float
    high: float
    before: Gap
    after: Gap


def shrinkage(
    nominal: Linearised,
    effect: Linearised,
    seed: int,
    train: BoolArray | None = None,
    judge: BoolArray | None = None,
    floor_mm: float = 0.0,
    draws: int = DRAWS,
    level: float = LEVEL,
) -> Shrinkage:
    """Compare the fit of the nominal parameters with one that has the effect too.

    Parameters
    ----------
    nominal : Linearised
        At the nominal fit.
    effect : Linearised
        At the fit with the effect, whose parameters are among its nominal ones. Same
        points, states and noise.
    seed : int
        The same seed gives the same interval.
    train, judge : ndarray of bool, shape (m,), optional
        Residuals to fit to and to judge by; all, which is the in-sample share.
    floor_mm : float
        As for `workers.diagnosis.gap.gap`.
    draws : int
        Of the bootstrap, >= 20.
    level : float
        Of the intervals.

    Raises
    ------
    InputError
        If the fits have not the same residuals, or `draws` is too small.
    """
    if nominal.size != effect.size or draws < 20:
        raise InputError(
            "A shrinkage needs two fits of the same residuals and at least 20 draws, found "
            f"{nominal.size} and {effect.size} residuals and {draws} draws."
        )
    fits = LinearFit(nominal, train, judge), LinearFit(effect, train, judge)
    before, after = (gap(fit, floor_mm=floor_mm, level=level) for fit in fits)
    share = float(
        _share(_squared(before.excess_mm2, floor_mm), _squared(after.excess_mm2, floor_mm))
    )
    if before.gap_mm == 0.0:
        return Shrinkage(float("nan"), float("nan"), float("nan"), before, after)
    means = _without_noise(nominal, effect)
    noise = nominal.covariance_factor @ np.random.default_rng(seed).standard_normal(
        (nominal.size, draws)
    )
    shares = _share(
        *(_excess(fit, mean, noise, floor_mm) for fit, mean in zip(fits, means, strict=True))
    )
    low, high = np.nanquantile(shares, [(1 - level) / 2, (1 + level) / 2])
    return Shrinkage(share, float(low), float(high), before, after)


def _without_noise(nominal: Linearised, effect: Linearised) -> tuple[FloatArray, FloatArray]:
    """Residuals of both models on an image without noise, as far as the data know.

    What the effect leaves is noise but for a part of the size of the gap that is left.
    """
    fit = LinearFit(effect)
    left = fit.residual
    square = max(float((left**2).mean()), np.finfo(float).tiny)
    noise = left * (1.0 - min(1.0, np.sqrt(max(0.0, fit.excess_mm2) / square)))
    return nominal.residual - noise, effect.residual - noise


def _excess(fit: LinearFit, mean: FloatArray, noise: FloatArray, floor_mm: float) -> FloatArray:
    squares = (fit.after(mean[:, None] + noise) ** 2).mean(axis=0)
    return _squared(squares - fit.noise_mm2.mean(), floor_mm)


def _squared(excess_mm2: FloatArray | float, floor_mm: float) -> FloatArray:
    return np.maximum(excess_mm2, 0.0) + floor_mm**2


def _share(before: FloatArray, after: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before > 0, 1.0 - after / before, np.nan)
