"""Points on interfaces that a scan does not show.

They are on a piece of tissue that one drawing has and another has not.

Nothing that deforms a body moves one point by millimetres and leaves its neighbours: residuals are
fitted by constants, poses and a smooth displacement, by least squares that are reweighted so that
no single point pulls much (Huber's weights), then none at all (Tukey's biweight; P. J. Huber,
Robust Statistics, 1981). What lies far off such a fit has no counterpart. Nor have a small piece of
interface, and neighbours, that lie far off what all other points say of their place: a piece that
only the scan at rest has is off in every other one, each time by what a single point might be. One
such point of 12 mm among a thousand speaks against every cause in the catalogue with certainty.

A displacement that is all but free follows a few points where no others are near. So groups of few
that lie far off what constants and poses explain are judged once more by all others, under a
displacement of common size.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.special import gammaincc, log_ndtr

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.diagnosis.settings.values import SETTINGS

# Of the normal distribution, over the median of its absolute values.
SD_OF_MEDIAN = 1.4826
# Logarithm of how probable it is that a residual lies as far off, on either side.
_LOG_FAR = float(np.log(2.0) + log_ndtr(-SETTINGS.unmatched.far))


def matched(
    points: InterfacePoints,
    covariance: FloatArray,
    columns: FloatArray,
    smooth: FloatArray,
    residual: FloatArray,
    beside_mm: float,
) -> BoolArray:
    """Return which points have a counterpart in every scan, shape (k,).

    Parameters
    ----------
    points : InterfacePoints
        Seen in each of s scans, k of them.
    covariance : ndarray, shape (s k, s k)
        Of the noise, as it is stated, in mm^2.
    columns : ndarray, shape (s k, q)
        What constants and poses do to the residuals, per prior standard deviation.
    smooth : ndarray, shape (s k, r)
        The same of a displacement that nobody listed, of common size.
    residual : ndarray, shape (s k,)
        In mm.
    beside_mm : float
        How far around a point that is far off others may be off for the same reason.
    """
    settings = SETTINGS.unmatched
    interface = np.tile(points.interface, len(residual) // len(points))
    plain = _Fit(columns, residual, covariance, interface, np.ones(len(residual)), residual)
    free = replace(plain, columns=np.hstack([columns, settings.freer * smooth]))
    free, off = _off_all_others(points, free.reweighted(_huber), beside_mm)
    shown = np.asarray(~off.any(axis=0))
    plain = plain.of(shown)
    groups = _far_groups(points, plain, shown, beside_mm)
    if groups:
        usual = _as_large_as_seen(smooth, plain.away - free.away) * smooth
        common = replace(plain, columns=np.hstack([columns, usual])).of(shown)
        for group in groups:
            shown[group] &= not common.judged_by_others(group, len(off)).is_improbable
    return shown if shown.mean() > 1 - settings.most else np.ones_like(shown)


def _off_all_others(
    points: InterfacePoints, fit: "_Fit", beside_mm: float
) -> tuple["_Fit", BoolArray]:
    """Return a fit without what lies far off it, and which points do in each scan, (s, k).

    Small pieces as a whole; then single points, neighbours that are improbable together, and what
    is beside either.
    """
    settings, scans = SETTINGS.unmatched, len(fit.residual) // len(points)
    off = np.zeros((scans, len(points)), np.bool_)
    for piece in _small_pieces(points):
        off[:, piece] = fit.judged_by_others(piece, scans).is_far
    fit = replace(fit, use=np.where(off.ravel(), 0.0, 1.0)).reweighted(_biweight)
    far = (np.abs(fit.away) / fit.scale).reshape(scans, -1)
    off |= far > settings.far
    tree = KDTree(points.points)
    around = [np.array(near, np.int32) for near in tree.query_ball_point(points.points, beside_mm)]
    off |= _improbable_together(fit, far, around)
    for scan, outliers in enumerate(off):
        for one in np.flatnonzero(outliers).tolist():
            off[scan, around[one]] |= far[scan, around[one]] > settings.beside
    return fit, off


def _far_groups(
    points: InterfacePoints, plain: "_Fit", shown: BoolArray, beside_mm: float
) -> list[IntArray]:
    """Return groups of few neighbours that lie far off what constants and poses explain."""
    far = (np.abs(plain.away) / plain.scale).reshape(-1, len(points)).max(axis=0)
    which = np.flatnonzero(shown & (far > SETTINGS.unmatched.far)).astype(np.int32)
    tree = KDTree(points.points[which].reshape(-1, 3))
    near = tree.sparse_distance_matrix(tree, beside_mm)
    count, label = connected_components(near, directed=False)
    groups = [which[label == number] for number in range(count)]
    return [group for group in groups if len(group) <= SETTINGS.unmatched.small_piece]


def _as_large_as_seen(smooth: FloatArray, displacement: FloatArray) -> float:
    """Return how much larger than common a displacement is, (s k,); at least one."""
    common = float(np.sqrt((smooth**2).sum(axis=1).mean()))
    return max(1.0, float(np.sqrt((displacement**2).mean())) / common)


def _improbable_together(fit: "_Fit", far: FloatArray, around: Sequence[IntArray]) -> BoolArray:
    """Return which points lie off with their neighbours, by little in each of all scans, (k,)."""
    doubtful = np.asarray((far > SETTINGS.unmatched.beside).any(axis=0))
    found = np.zeros(len(doubtful), np.bool_)
    for one in np.flatnonzero(doubtful).tolist():
        near = around[one][doubtful[around[one]]]
        if not found[near].all():
            found[near] |= fit.judged_by_others(near, len(far)).is_improbable
    return found


def _small_pieces(points: InterfacePoints) -> Iterator[IntArray]:
    """Yield the numbers of the points of each connected piece of few."""
    for part in np.unique(points.part):
        piece = np.flatnonzero(points.part == part).astype(np.int32)
        if len(piece) <= SETTINGS.unmatched.small_piece:
            yield piece


@dataclass(frozen=True, eq=False)
class _Judged:
    """What rows of some points leave of a fit of all others: (s, n) in mm, and its covariance."""

    away: FloatArray
    covariance: FloatArray

    @property
    def is_far(self) -> bool:
        """Whether most points lie far off in some scan."""
        relative = np.abs(self.away) / np.sqrt(np.diag(self.covariance)).reshape(self.away.shape)
        return bool(np.median(relative, axis=1).max() > SETTINGS.unmatched.far)

    @property
    def is_improbable(self) -> bool:
        """Whether all of them together are as improbable as one residual that is far off."""
        away = self.away.ravel()
        squares = away @ np.linalg.solve(self.covariance, away)
        # The part of a chi-squared distribution that lies further out.
        return bool(gammaincc(len(away) / 2, squares / 2) < np.exp(_LOG_FAR))


@dataclass(frozen=True, eq=False)
class _Fit:
    """A reweighted fit: of what, with which rows, and what it leaves."""

    columns: FloatArray
    residual: FloatArray
    covariance: FloatArray
    interface: IntArray
    use: FloatArray
    away: FloatArray
    weights: FloatArray | None = None

    @property
    def stated_mm(self) -> FloatArray:
        """Standard deviation of each residual, as it is stated."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def scale(self) -> FloatArray:
        """Robust deviation of each residual's interface, in mm; no less than plausible."""
        stated_mm = self.stated_mm
        relative = np.abs(self.away / stated_mm)
        found = np.empty(len(relative))
        for one in np.unique(self.interface):
            own = self.interface == one
            used = own & (self.use > 0)
            found[own] = SD_OF_MEDIAN * np.median(relative[used if used.any() else own])
        return np.asarray(np.maximum(found, SETTINGS.unmatched.least_scale) * stated_mm)

    def reweighted(self, weigh: Callable[[FloatArray], FloatArray]) -> "_Fit":
        """Return the fit under such weights, begun from what this one leaves."""
        at, before = self, np.full(len(self.residual), np.inf)
        for _ in range(SETTINGS.unmatched.iterations):
            scale = at.scale
            if np.abs(scale / before - 1).max() < SETTINGS.unmatched.settled:
                break
            weights = at.use * weigh(at.away / scale) / scale**2
            H = np.eye(self.columns.shape[1]) + self.columns.T @ (weights[:, None] * self.columns)
            found = np.linalg.solve(H, self.columns.T @ (weights * self.residual))
            away = self.residual - self.columns @ found
            at, before = replace(at, away=away, weights=weights), scale
        return at

    def of(self, shown: BoolArray) -> "_Fit":
        """Return the fit to some of the points alone, shape (k,)."""
        use = np.tile(shown, len(self.residual) // len(shown)).astype(np.float64)
        fit = replace(self, use=use).reweighted(_huber)
        return fit.reweighted(_biweight)

    def judged_by_others(self, piece: IntArray, scans: int) -> _Judged:
        """Return what some points leave of the fit of all others, in all scans."""
        assert self.weights is not None
        rows = (np.arange(scans)[:, None] * (len(self.residual) // scans) + piece).ravel()
        weights = self.weights.copy()
        weights[rows] = 0.0
        H = np.eye(self.columns.shape[1]) + self.columns.T @ (weights[:, None] * self.columns)
        own = self.columns[rows]
        others = self.columns.T @ (weights * self.residual)
        solved = np.linalg.solve(H, np.column_stack([own.T, others]))
        relative = (self.scale / self.stated_mm)[rows]
        noise = self.covariance[np.ix_(rows, rows)] * relative[:, None] * relative
        away = self.residual[rows] - own @ solved[:, -1]
        return _Judged(away.reshape(scans, -1), own @ solved[:, :-1] + noise)


def _huber(away: FloatArray) -> FloatArray:
    """Return weights under which the fit has one optimum only."""
    return np.asarray(np.minimum(1.0, SETTINGS.unmatched.huber / np.maximum(np.abs(away), 1e-12)))


def _biweight(away: FloatArray) -> FloatArray:
    """Return weights that are zero far away."""
    return np.asarray(np.maximum(1.0 - (away / SETTINGS.unmatched.biweight) ** 2, 0.0) ** 2)
