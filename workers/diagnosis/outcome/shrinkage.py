r"""How much of the gap an effect takes away: ``1 - G_with^2 / G_nominal^2``.

The interval is a parametric bootstrap in the linearised model. Its truth is what the
fits found: the systematic part of the residual with the effect, scaled to the size that
its gap has, plus what the effect changed. Noise of covariance C is drawn around it, the floor
from its range, and how much noise is to be taken off; both models are fitted again, and the
shares of all draws are ranked.
It is a little wide for the share of one image, which moves along with its estimate.

Fitted to some states and judged by the others, the same number is the held-out share. With
each state judged by a fit to the others, all of them are seen, and none by its own fit (the
cross-validation of M. Stone, J. R. Stat. Soc. B 36 (1974) 111). Where the others do not hold what
moves a state, the linear model would carry it anywhere: such a state is not judged.

The noise cancels in the difference of both squares, which is known far better than either. So
the square before is the one after, as `diagnosis.outcome.gap` credits it, plus that difference.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.algebra.linear_fit import LinearFit, Registration
from palpate.workers.diagnosis.algebra.linearisation import Linearised
from palpate.workers.diagnosis.outcome.gap import Gap, credited, gap, pooled, without_effect
from palpate.workers.diagnosis.settings.values import SETTINGS

Pair = tuple[LinearFit, LinearFit]
"""Without and with the effect."""


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


class _Draws(NamedTuple):
    """Noise of the residuals (m, n); errors of its variance and parts of the floor, (n,)."""

    noise: FloatArray
    wrong: FloatArray
    floors: FloatArray


class Comparison:
    """The fit of the nominal parameters beside one that has the effect too.

    What all comparisons of them share, above all the draws of the noise, is made once.

    Parameters
    ----------
    nominal : Linearised
        At the nominal fit.
    effect : Linearised
        At the fit with the effect, whose parameters are among its nominal ones. Same
        points, states and noise.
    seed : int
        The same seed gives the same interval.
    floor_mm : float
        As for `workers.diagnosis.outcome.gap.gap`.
    judged : ndarray of bool, shape (m,), optional
        Residuals that are distances; all.
    registered : int
        So many parameters, the last of both fits, say where the scans lie: the fit with the
        effect to all residuals sets them in both.
    draws : int
        Of the bootstrap, >= 20.

    Raises
    ------
    InputError
        If the fits have not the same residuals, or `draws` is too small.
    """

    def __init__(
        self,
        nominal: Linearised,
        effect: Linearised,
        seed: int,
        floor_mm: float = 0.0,
        registered: int = 0,
        judged: BoolArray | None = None,
        draws: int = SETTINGS.gap.draws,
    ) -> None:
        if nominal.size != effect.size or draws < 20:
            raise InputError(
                "A shrinkage needs two fits of the same residuals and at least 20 draws, found "
                f"{nominal.size} and {effect.size} residuals and {draws} draws."
            )
        self.nominal, self.effect, self.seed = nominal, effect, seed
        self.floor_mm, self.registered, self.draws = floor_mm, registered, draws
        self.judged = np.ones(nominal.size, np.bool_) if judged is None else judged

    def shrinkage(
        self, train: BoolArray | None = None, judge: BoolArray | None = None
    ) -> Shrinkage:
        """Return the share of the gap that the effect removes.

        Parameters
        ----------
        train, judge : ndarray of bool, shape (m,), optional
            Residuals to fit to and to judge by; all, which is the in-sample share.
        """
        return self._compared([self._pair(train, self.judged if judge is None else judge)])

    def unseen(self, states: IntArray) -> tuple[Shrinkage | None, list[Shrinkage | None]]:
        """Return the share of fits that never saw what they are judged by, and of each of them.

        None stands for a state that a fit to the others moves further than the linear model
        holds, `unseen_reach` of the settings; without any that is judged, for all together.

        Parameters
        ----------
        states : ndarray of int, shape (m,)
            Two or more; each is judged by a fit to the others, and all are taken together.

        Raises
        ------
        InputError
            If there is one state only.
        """
        every = np.unique(states)
        if len(every) < 2:
            raise InputError("To leave a state out, there must be two or more; found one.")
        pairs = [self._pair(states != one, self.judged & (states == one)) for one in every]
        held = [pair if self._holds(pair) else None for pair in pairs]
        judged = [pair for pair in held if pair is not None]
        each = [None if pair is None else self._compared([pair]) for pair in held]
        return self._compared(judged) if judged else None, each

    def _holds(self, pair: Pair) -> bool:
        """Return whether fits move what they are judged by as little as a linear model may."""
        limit = SETTINGS.gap.unseen_reach**2 * (self.nominal.residual[pair[0].judge] ** 2).mean()
        return all(
            ((fit.residual - fit.problem.residual[fit.judge]) ** 2).mean() <= limit for fit in pair
        )

    def _pair(self, train: BoolArray | None, judge: BoolArray | None) -> Pair:
        """Return the fits of both, with the scans where the whole fit with the effect puts them."""
        both, count = (self.nominal, self.effect), self.registered
        where = [
            Registration.by(self._whole, count, fit.residual) if count else None for fit in both
        ]
        without, along = (
            LinearFit(fit, train, judge, registration=registration)
            for fit, registration in zip(both, where, strict=True)
        )
        return without, along

    def _compared(self, pairs: Sequence[Pair]) -> Shrinkage:
        """Compare fits without and with the effect, each judged by its part of the residuals."""
        without, along = zip(*pairs, strict=True)
        before, after = (pooled([gap(f) for f in fits], self.floor_mm) for fits in (without, along))
        before = without_effect(before, after, self.floor_mm)
        share = float(_share(np.array(before.gap_mm**2), np.array(after.gap_mm**2)))
        if before.gap_mm == 0.0:
            return Shrinkage(float("nan"), float("nan"), float("nan"), before, after)
        draws, means = self._drawn, self._without_noise
        wrong = SETTINGS.gap.noise_variance_sd * before.noise_mm**2 * draws.wrong
        drawn = [
            _excess(fits, mean, draws.noise) + wrong
            for fits, mean in zip((without, along), means, strict=True)
        ]
        left = credited(drawn[1], after, self.floor_mm)
        squares = (left + drawn[0] - drawn[1], left)
        floors = self.floor_mm * draws.floors
        shares = _share(*(np.maximum(square, 0.0) + floors**2 for square in squares))
        level = SETTINGS.gap.level
        low, high = np.nanquantile(shares, [(1 - level) / 2, (1 + level) / 2])
        return Shrinkage(share, float(low), float(high), before, after)

    @cached_property
    def _whole(self) -> LinearFit:
        return LinearFit(self.effect)

    @cached_property
    def _drawn(self) -> _Draws:
        nominal, count = self.nominal, self.registered
        rng = np.random.default_rng(self.seed)
        noise = nominal.covariance_factor @ rng.standard_normal((nominal.size, self.draws))
        first = len(nominal.nominal_sd) - count
        poses = (nominal.nominal * nominal.nominal_sd)[:, first:]
        noise += poses @ rng.standard_normal((count, self.draws))
        return _Draws(noise, rng.standard_normal(self.draws), parts_of_floor(rng, self.draws))

    @cached_property
    def _without_noise(self) -> tuple[FloatArray, FloatArray]:
        """Residuals of both models on an image without noise, as far as the data know.

        What the effect leaves is noise but for a part of the size of the gap that is left.
        """
        left = self._whole.residual
        square = max(float((left**2).mean()), np.finfo(float).tiny)
        excess = max(0.0, self._whole.excess_mm2)
        noise = left * (1.0 - min(1.0, np.sqrt(excess / square)))
        return self.nominal.residual - noise, self.effect.residual - noise


def _excess(fits: Sequence[LinearFit], mean: FloatArray, noise: FloatArray) -> FloatArray:
    """Return that of every draw, over all that is judged."""
    sums = [
        (fit.after(mean[:, None] + noise) ** 2).sum(axis=0) - fit.noise_mm2.sum() for fit in fits
    ]
    return np.asarray(np.sum(sums, axis=0) / sum(len(fit.noise_mm2) for fit in fits))


def parts_of_floor(rng: np.random.Generator, draws: int) -> FloatArray:
    """Draw parts of the floor: log-normal, nine in ten within their range."""
    ends = np.log(SETTINGS.gap.floor_range)
    return np.asarray(np.exp(rng.normal(ends.mean(), np.ptp(ends) / 2 / ndtri(0.95), draws)))


def _share(before: FloatArray, after: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before > 0, 1.0 - after / before, np.nan)
