"""Find points on interfaces that a scan does not show: a piece of tissue that one drawing has and
another has not.

Nothing that deforms a body moves one point by millimetres and leaves its neighbours: residuals are
fitted by constants, poses and a smooth displacement, by least squares that are reweighted so that
no single point pulls much (Huber's weights), then none at all (Tukey's biweight; P. J. Huber,
Robust Statistics, 1981). What lies far off such a fit has no counterpart. One such point of 12 mm
among a thousand speaks against every cause in the catalogue with certainty.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial import KDTree

from storage.values import BoolArray, FloatArray, IntArray
from workers.comparison.observation.interface import InterfacePoints
from workers.diagnosis.settings import SETTINGS

# Of the normal distribution, over the median of its absolute values.
SD_OF_MEDIAN = 1.4826


def matched(
    points: InterfacePoints, stated_mm: FloatArray, columns: FloatArray, residual: FloatArray
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
    """
    settings = SETTINGS.unmatched
    interface = np.tile(points.interface, len(residual) // len(points))
    away = residual
    for weights in (_huber, _biweight):
        away, scale = _left(columns, residual, away, weights, stated_mm, interface)
    far = (np.abs(away) / scale).reshape(-1, len(points))
    alone = far > settings.far
    near = far > settings.beside
    tree = KDTree(points.points)
    for scan, outliers in enumerate(alone):
        for one in np.flatnonzero(outliers):
            around = tree.query_ball_point(points.points[one], settings.beside_mm)
            alone[scan, around] |= near[scan, around]
    shown = np.asarray(~alone.any(axis=0))
    return shown if shown.mean() > 1 - settings.most else np.ones_like(shown)


def _left(
    columns: FloatArray,
    residual: FloatArray,
    away: FloatArray,
    weights: Callable[[FloatArray], FloatArray],
    stated_mm: FloatArray,
    interface: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """Return what a reweighted fit leaves, from what an earlier one left, and its deviation."""
    settings = SETTINGS.unmatched
    least, scale = settings.least_scale * stated_mm, np.full(len(residual), np.inf)
    for _ in range(settings.iterations):
        before = scale
        scale = np.maximum(_robust_sd(away / stated_mm, interface) * stated_mm, least)
        if np.abs(scale / before - 1).max() < settings.settled:
            break
        white, w = columns / scale[:, None], weights(away / scale)[:, None]
        H = np.eye(white.shape[1]) + white.T @ (w * white)
        away = residual - columns @ np.linalg.solve(H, white.T @ (w[:, 0] * residual / scale))
    return away, scale


def _huber(away: FloatArray) -> FloatArray:
    """Return weights under which the fit has one optimum only."""
    return np.asarray(np.minimum(1.0, SETTINGS.unmatched.huber / np.maximum(np.abs(away), 1e-12)))


def _biweight(away: FloatArray) -> FloatArray:
    """Return weights that are zero far away."""
    return np.asarray(np.maximum(1.0 - (away / SETTINGS.unmatched.biweight) ** 2, 0.0) ** 2)


def _robust_sd(away: FloatArray, interface: IntArray) -> FloatArray:
    """Return that of the interface of each residual."""
    found = np.empty(len(away))
    for one in np.unique(interface):
        own = interface == one
        found[own] = SD_OF_MEDIAN * np.median(np.abs(away[own]))
    return found
