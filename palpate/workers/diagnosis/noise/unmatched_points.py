"""Points on interfaces without a counterpart in a scan.

They are on a piece of tissue that is included in one segmentation but missing from another.

No deformation moves one point by millimetres and leaves its neighbours in place. Residuals are
therefore fitted by constants, poses and a smooth displacement, with least squares reweighted to
limit the influence of single points (Huber's weights) and then to remove it (Tukey's biweight; P.
J. Huber, Robust Statistics, 1981). Points far from this fit have no counterpart. The same holds for
a small piece of an interface, or for neighbouring points, far from their prediction from all other
points: a piece present only in the scan at rest is off in every other scan, though in each by no
more than a single point might be. One such point, 12 mm off, among a thousand would rule out every
cause in the catalogue.

A smooth displacement can follow a few points that have no others nearby. Small groups far from the
fit by constants and poses are therefore compared once more with all other points, under a
displacement of usual size.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.special import gammaincc, log_ndtr

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS

# Standard deviation of a normal distribution divided by the median of its absolute values.
SD_OF_MEDIAN = 1.4826
# Log probability of a residual that is as far off, on either side.
_LOG_FAR = float(np.log(2.0) + log_ndtr(-SETTINGS.unmatched.far))


def matched(
    points: InterfacePoints,
    covariance: FloatArray,
    columns: FloatArray,
    smooth: FloatArray,
    residual: FloatArray,
    beside_mm: float,
) -> BoolArray:
    """Find the points that have a counterpart in every scan, shape (k,).

    Parameters
    ----------
    points : InterfacePoints
        The k points compared in each of s scans.
    covariance : ndarray, shape (s k, s k)
        Given covariance of the noise, in mm^2.
    columns : ndarray, shape (s k, q)
        Derivatives with respect to constants and poses, per prior standard deviation.
    smooth : ndarray, shape (s k, r)
        Columns of an unlisted displacement of usual size.
    residual : ndarray, shape (s k,)
        Residuals in mm.
    beside_mm : float
        Radius around an outlier within which other points may be off for the same reason.
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
    """Return a fit without outliers, and the outliers in each scan, shape (s, k).

    Outliers are, first, whole small pieces; then single points, neighbours that are improbable
    together, and doubtful points near either.
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
        for outlier in np.flatnonzero(outliers).tolist():
            off[scan, around[outlier]] |= far[scan, around[outlier]] > settings.beside
    return fit, off


def _far_groups(
    points: InterfacePoints, plain: "_Fit", shown: BoolArray, beside_mm: float
) -> list[IntArray]:
    """Return small groups of neighbours far from the fit by constants and poses."""
    far = (np.abs(plain.away) / plain.scale).reshape(-1, len(points)).max(axis=0)
    which = np.flatnonzero(shown & (far > SETTINGS.unmatched.far)).astype(np.int32)
    tree = KDTree(points.points[which].reshape(-1, 3))
    near = tree.sparse_distance_matrix(tree, beside_mm)
    count, label = connected_components(near, directed=False)
    groups = [which[label == number] for number in range(count)]
    return [group for group in groups if len(group) <= SETTINGS.unmatched.small_piece]


def _as_large_as_seen(smooth: FloatArray, displacement: FloatArray) -> float:
    """Return the size of a displacement, (s k,), relative to the usual size; at least one."""
    common = float(np.sqrt((smooth**2).sum(axis=1).mean()))
    return max(1.0, float(np.sqrt((displacement**2).mean())) / common)


def _improbable_together(fit: "_Fit", far: FloatArray, around: Sequence[IntArray]) -> BoolArray:
    """Find points that, like their neighbours, are slightly off in all scans, (k,)."""
    doubtful = np.asarray((far > SETTINGS.unmatched.beside).any(axis=0))
    found = np.zeros(len(doubtful), np.bool_)
    for one in np.flatnonzero(doubtful).tolist():
        near = around[one][doubtful[around[one]]]
        if not found[near].all():
            found[near] |= fit.judged_by_others(near, len(far)).is_improbable
    return found


def _small_pieces(points: InterfacePoints) -> Iterator[IntArray]:
    """Yield the indices of the points of each small connected piece."""
    for part in np.unique(points.part):
        piece = np.flatnonzero(points.part == part).astype(np.int32)
        if len(piece) <= SETTINGS.unmatched.small_piece:
            yield piece


@dataclass(frozen=True, eq=False)
class _Judged:
    """Residuals of points in a fit to all other points, (s, n) in mm, with their covariance."""

    away: FloatArray
    covariance: FloatArray

    @property
    def is_far(self) -> bool:
        """Whether most points are far off in any scan."""
        relative = np.abs(self.away) / np.sqrt(np.diag(self.covariance)).reshape(self.away.shape)
        return bool(np.median(relative, axis=1).max() > SETTINGS.unmatched.far)

    @property
    def is_improbable(self) -> bool:
        """Whether the points together are as improbable as one residual that is far off."""
        away = self.away.ravel()
        squares = away @ np.linalg.solve(self.covariance, away)
        # The upper tail of a chi-squared distribution.
        return bool(gammaincc(len(away) / 2, squares / 2) < np.exp(_LOG_FAR))


@dataclass(frozen=True, eq=False)
class _Fit:
    """A reweighted fit: its columns, the rows in use, and its residuals."""

    columns: FloatArray
    residual: FloatArray
    covariance: FloatArray
    interface: IntArray
    use: FloatArray
    away: FloatArray
    weights: FloatArray | None = None

    @property
    def stated_mm(self) -> FloatArray:
        """Given standard deviation of each residual."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def scale(self) -> FloatArray:
        """Robust deviation on each residual's interface, in mm, with a plausible minimum."""
        stated_mm = self.stated_mm
        relative = np.abs(self.away / stated_mm)
        found = np.empty(len(relative))
        for one in np.unique(self.interface):
            own = self.interface == one
            used = own & (self.use > 0)
            found[own] = SD_OF_MEDIAN * np.median(relative[used if used.any() else own])
        return np.asarray(np.maximum(found, SETTINGS.unmatched.least_scale) * stated_mm)

    def reweighted(self, weigh: Callable[[FloatArray], FloatArray]) -> "_Fit":
        """Return the fit under new weights, starting from the residuals of this fit."""
        fit, before = self, np.full(len(self.residual), np.inf)
        for _ in range(SETTINGS.unmatched.iterations):
            scale = fit.scale
            if np.abs(scale / before - 1).max() < SETTINGS.unmatched.settled:
                break
            weights = fit.use * weigh(fit.away / scale) / scale**2
            H = np.eye(self.columns.shape[1]) + self.columns.T @ (weights[:, None] * self.columns)
            solution = np.linalg.solve(H, self.columns.T @ (weights * self.residual))
            away = self.residual - self.columns @ solution
            fit, before = replace(fit, away=away, weights=weights), scale
        return fit

    def of(self, shown: BoolArray) -> "_Fit":
        """Return the fit to a subset of the points, shape (k,)."""
        use = np.tile(shown, len(self.residual) // len(shown)).astype(np.float64)
        fit = replace(self, use=use).reweighted(_huber)
        return fit.reweighted(_biweight)

    def judged_by_others(self, piece: IntArray, scans: int) -> _Judged:
        """Return the residuals of some points in a fit to all other points, in all scans."""
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
    """Return Huber's weights, under which the fit has a single optimum."""
    return np.asarray(np.minimum(1.0, SETTINGS.unmatched.huber / np.maximum(np.abs(away), 1e-12)))


def _biweight(away: FloatArray) -> FloatArray:
    """Return Tukey's biweights, which are zero for outliers."""
    return np.asarray(np.maximum(1.0 - (away / SETTINGS.unmatched.biweight) ** 2, 0.0) ** 2)
