r"""The gap in mm, the difference between model and image in excess of the noise, and its shrinkage.

The mean square of a residual in excess of its noise,

.. math:: E = \overline{r_{fit}^2} - \overline{\mathrm{noise}^2},

is unbiased (see `LinearFit` in `workers.diagnosis.linearisation`), and its standard deviation s
follows from

.. math:: \mathrm{Var}(r'r) = 2\,\mathrm{tr}\,D^2 + 4\,m'Dm

for a residual with mean m and covariance D. Noise alone makes E vary by about s, which exceeds a
gap of 0.1 mm. If the error of even the true model is known (the floor G_0), the squared gap is the
squared floor plus the part of E beyond chance,

.. math:: G^2 = G_0^2 + \frac{E_+^3}{E^2 + (2 s)^2},

whose second term is half of E if E is 2 s: a smooth form of the garrote of L. Breiman,
Technometrics 37 (1995) 373. Without a floor, G^2 is the positive part of E.

The shrinkage is the share of the squared gap that an effect removes: ``1 - G_with^2 /
G_nominal^2``. Its interval is a parametric bootstrap in the linearised model. The truth of the
bootstrap comes from the fits: the systematic part of the residual with the effect, scaled to the
size of its gap, plus the change due to the effect. Each draw adds noise of covariance C, a floor
from its range and an error in the noise variance; both models are refitted, and the quantiles of
the shares give the interval. It is slightly too wide for the share of one image, which varies
together with its estimate.

When fitted to some states and assessed on the others, the same number is the held-out share.
Leaving out each state in turn assesses every state by a fit to the others (cross-validation, M.
Stone, J. R. Stat. Soc. B 36 (1974) 111). If the other states do not constrain a state, the linear
model would extrapolate too far, and that state is not assessed.

The noise cancels in the difference between both squares, which is far more precise than either. The
square before is therefore the square after, as credited by `credited`, plus that difference.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.linearisation import LinearFit, Linearised, Registration
from palpate.workers.diagnosis.outcome.diagnosis_summary import RegionGap


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


def region_gap(
    fit: LinearFit, chosen: BoolArray, scan: str, interface: str, region: str
) -> RegionGap:
    """Return the gap in a region, from the selected residuals of a fit, shape (m,)."""
    estimate, residual = gap(fit, chosen), fit.residual[chosen]
    return RegionGap(
        scan=scan,
        interface=interface,
        region=region,
        gap_mm=estimate.gap_mm,
        low_mm=estimate.low_mm,
        high_mm=estimate.high_mm,
        noise_mm=estimate.noise_mm,
        points=estimate.points,
        signed_mean_mm=float(residual.mean()),
        p50_mm=float(np.quantile(np.abs(residual), 0.5)),
        p95_mm=float(np.quantile(np.abs(residual), 0.95)),
        significant=bool(estimate.low_mm > SETTINGS.gap.nothing_mm),
    )


Pair = tuple[LinearFit, LinearFit]
"""Values without and with the effect."""


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """Share of the squared gap that an effect removes.

    Parameters
    ----------
    share : float
        Share, at most 1; negative where the effect makes the gap larger, nan without a gap.
    low, high : float
        Interval of the share; nan without a gap.
    before, after : Gap
        Gap without and with the effect.
    """

    share: float
    low: float
    high: float
    before: Gap
    after: Gap


class _Draws(NamedTuple):
    """Noise of the residuals (m, n); errors in its variance and factors of the floor, (n,)."""

    noise: FloatArray
    wrong: FloatArray
    floors: FloatArray


class Comparison:
    """Comparison of the nominal fit with a fit that includes the effect.

    Quantities shared by all comparisons, in particular the noise draws, are computed once.

    Parameters
    ----------
    nominal : Linearised
        Linearisation at the nominal fit.
    effect : Linearised
        Linearisation at the fit with the effect, whose parameters are added to the nominal ones,
        for the same points, states and noise.
    seed : int
        Seed; equal seeds give equal intervals.
    floor_mm : float
        See `workers.diagnosis.outcome.gap_and_shrinkage.gap`.
    judged : ndarray of bool, shape (m,), optional
        Residuals that are distances; all by default.
    registered : int
        Number of pose parameters, which come last in both fits. Both use their values from the fit
        with the effect to all residuals.
    draws : int
        Number of bootstrap draws, >= 20.

    Raises
    ------
    InputError
        If the fits have different residuals, or `draws` is too small.
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
                "A shrinkage needs two fits to the same residuals and at least 20 draws, found "
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
            Residuals to fit and to assess; all by default, which gives the in-sample share.
        """
        return self._compared([self._pair(train, self.judged if judge is None else judge)])

    def unseen(
        self, states: IntArray, chosen: Sequence[bool] | None = None
    ) -> tuple[Shrinkage | None, list[Shrinkage | None]]:
        """Return the held-out share of all states together and of each state.

        It is None for a state that the fit to the others moves beyond the range of the linear model
        (`unseen_reach` in the settings), and for the total if no state can be assessed.

        Parameters
        ----------
        states : ndarray of int, shape (m,)
            State of each residual; there must be at least two states, each assessed by a fit to the
            others.
        chosen : sequence of bool, optional
            Whether the other states name the effect; always by default. Otherwise the nominal model
            takes its place, and nothing is removed from the gap of the state.

        Raises
        ------
        InputError
            If there is only one state.
        """
        every = np.unique(states)
        if len(every) < 2:
            raise InputError("Leaving out a state requires two or more states; found one.")
        pairs = [self._pair(states != one, self.judged & (states == one)) for one in every]
        if chosen is not None:
            named = zip(pairs, chosen, strict=True)
            pairs = [pair if is_named else (pair[0], pair[0]) for pair, is_named in named]
        held = [pair if self._holds(pair) else None for pair in pairs]
        judged = [pair for pair in held if pair is not None]
        each = [None if pair is None else self._compared([pair]) for pair in held]
        return self._compared(judged) if judged else None, each

    def _holds(self, pair: Pair) -> bool:
        """Return True if the fits keep the assessed residuals within the range of linearity."""
        limit = SETTINGS.gap.unseen_reach**2 * (self.nominal.residual[pair[0].judge] ** 2).mean()
        return all(
            ((fit.residual - fit.problem.residual[fit.judge]) ** 2).mean() <= limit for fit in pair
        )

    def _pair(self, train: BoolArray | None, judge: BoolArray | None) -> Pair:
        """Return both fits, with the poses from the fit with the effect to all residuals."""
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
        """Compare fits without and with the effect, each on its own part of the residuals."""
        without, along = zip(*pairs, strict=True)
        before, after = (pooled([gap(f) for f in fits], self.floor_mm) for fits in (without, along))
        before = without_effect(before, after, self.floor_mm)
        share = float(_share(np.array(before.gap_mm**2), np.array(after.gap_mm**2)))
        if before.gap_mm == 0.0:
            return Shrinkage(float("nan"), float("nan"), float("nan"), before, after)
        draws = self._drawn
        wrong = SETTINGS.gap.noise_variance_sd * before.noise_mm**2 * draws.wrong
        drawn = [self._excess(fits) + wrong for fits in (without, along)]
        left = credited(drawn[1], after, self.floor_mm)
        squares = (left + drawn[0] - drawn[1], left)
        floors = self.floor_mm * draws.floors
        shares = _share(*(np.maximum(square, 0.0) + floors**2 for square in squares))
        level = SETTINGS.gap.level
        low, high = np.nanquantile(shares, [(1 - level) / 2, (1 + level) / 2])
        return Shrinkage(share, float(low), float(high), before, after)

    def _excess(self, fits: Sequence[LinearFit]) -> FloatArray:
        """Return the excess of each bootstrap draw, over the residuals being assessed."""
        with_effect, noise = self._without_noise[1], self._drawn.noise
        sums = []
        for fit in fits:
            mean = with_effect if fit.problem is self.effect else self._without_noise[0]
            after = fit.after(mean[:, None] + noise)
            sums.append((after**2).sum(axis=0) - fit.noise_mm2.sum())
        return np.asarray(np.sum(sums, axis=0) / sum(len(fit.noise_mm2) for fit in fits))

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
        """Estimated residuals of both models on an image without noise.

        The residual with the effect is noise, except for a part as large as the remaining gap.
        """
        left = self._whole.residual
        square = max(float((left**2).mean()), np.finfo(float).tiny)
        excess = max(0.0, self._whole.excess_mm2)
        noise = left * (1.0 - min(1.0, np.sqrt(excess / square)))
        return self.nominal.residual - noise, self.effect.residual - noise


def parts_of_floor(rng: np.random.Generator, draws: int) -> FloatArray:
    """Draw log-normal factors of the floor, 90 % of which are in `floor_range`."""
    ends = np.log(SETTINGS.gap.floor_range)
    return np.asarray(np.exp(rng.normal(ends.mean(), np.ptp(ends) / 2 / ndtri(0.95), draws)))


def _share(before: FloatArray, after: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before > 0, 1.0 - after / before, np.nan)
