"""Find points on interfaces that a scan does not show: a piece of tissue that one drawing has and
another has not.

Nothing that deforms a body moves one point by millimetres and leaves its neighbours: residuals are
fitted by constants, poses and a smooth displacement, by least squares that are reweighted so that
no single point pulls much (Huber's weights), then none at all (Tukey's biweight; P. J. Huber,
Robust Statistics, 1981). What lies far off such a fit has no counterpart. Nor has a small piece of
interface that lies far off what all other points say of its place. One such point of 12 mm among a
thousand speaks against every cause in the catalogue with certainty.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from storage.values import BoolArray, FloatArray, IntArray
from workers.comparison.observation.interface import InterfacePoints
from workers.diagnosis.settings import SETTINGS

# Of the normal distribution, over the median of its absolute values.
SD_OF_MEDIAN = 1.4826


def matched(
    points: InterfacePoints,
    stated_mm: FloatArray,
    columns: FloatArray,
    residual: FloatArray,
    beside_mm: float,
) -> BoolArray:
    """Return which points have a counterpart in every scan, shape (k,).

    Parameters
    ----------
    points : InterfacePoints
        Seen in each of s scans, k of them.
    stated_mm : ndarray, shape (s k,)
        Standard deviation of the noise, as it is stated.
    columns : ndarray, shape (s k, q)
        What may move the residuals, per prior standard deviation.
    residual : ndarray, shape (s k,)
        In mm.
    beside_mm : float
        How far around a point that is far off others may be off for the same reason.
    """
    settings = SETTINGS.unmatched
    scans = len(residual) // len(points)
    interface = np.tile(points.interface, scans)
    fit = _Fit(columns, residual, stated_mm, interface, np.ones(len(residual)), residual)
    fit = fit.reweighted(_huber)
    alone = np.zeros((scans, len(points)), np.bool_)
    for piece in _small_pieces(points):
        alone[:, piece] = fit.is_alone(piece, scans)
    fit = replace(fit, use=np.where(alone.ravel(), 0.0, 1.0)).reweighted(_biweight)
    far = (np.abs(fit.away) / fit.scale).reshape(scans, -1)
    alone |= far > settings.far
    tree = KDTree(points.points)
    for scan, outliers in enumerate(alone):
        for one in np.flatnonzero(outliers):
            around = tree.query_ball_point(points.points[one], beside_mm)
            alone[scan, around] |= far[scan, around] > settings.beside
    shown = np.asarray(~alone.any(axis=0))
    return shown if shown.mean() > 1 - settings.most else np.ones_like(shown)


def _small_pieces(points: InterfacePoints) -> Iterator[IntArray]:
    """Yield the numbers of the points of each connected piece of few."""
    for part in np.unique(points.part):
        piece = np.flatnonzero(points.part == part).astype(np.int32)
        if len(piece) <= SETTINGS.unmatched.small_piece:
            yield piece


@dataclass(frozen=True, eq=False)
class _Fit:
    """A reweighted fit: of what, with which rows, and what it leaves."""

    columns: FloatArray
    residual: FloatArray
    stated_mm: FloatArray
    interface: IntArray
    use: FloatArray
    away: FloatArray
    weights: FloatArray | None = None

    @property
    def scale(self) -> FloatArray:
        """Robust deviation of each residual's interface, in mm; no less than plausible."""
        relative = np.abs(self.away / self.stated_mm)
        found = np.empty(len(relative))
        for one in np.unique(self.interface):
            own = self.interface == one
            used = own & (self.use > 0)
            found[own] = SD_OF_MEDIAN * np.median(relative[used if used.any() else own])
        return np.maximum(found, SETTINGS.unmatched.least_scale) * self.stated_mm

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

    def is_alone(self, piece: IntArray, scans: int) -> bool:
        """Return whether some scan has a piece far from where all other points expect it."""
        assert self.weights is not None
        rows = (np.arange(scans)[:, None] * (len(self.residual) // scans) + piece).ravel()
        weights = self.weights.copy()
        weights[rows] = 0.0
        H = np.eye(self.columns.shape[1]) + self.columns.T @ (weights[:, None] * self.columns)
        own = self.columns[rows]
        others = self.columns.T @ (weights * self.residual)
        solved = np.linalg.solve(H, np.column_stack([own.T, others]))
        away = self.residual[rows] - own @ solved[:, -1]
        sd = np.sqrt((own * solved[:, :-1].T).sum(axis=1) + self.scale[rows] ** 2)
        off = np.median((np.abs(away) / sd).reshape(scans, -1), axis=1)
        return bool(off.max() > SETTINGS.unmatched.far)


def _huber(away: FloatArray) -> FloatArray:
    """Return weights under which the fit has one optimum only."""
    return np.asarray(np.minimum(1.0, SETTINGS.unmatched.huber / np.maximum(np.abs(away), 1e-12)))


def _biweight(away: FloatArray) -> FloatArray:
    """Return weights that are zero far away."""
    return np.asarray(np.maximum(1.0 - (away / SETTINGS.unmatched.biweight) ** 2, 0.0) ** 2)
