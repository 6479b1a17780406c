r"""Segmentation noise, estimated from two segmentations of one image.

Both scatter about the truth, so the signed distance r from one to the other has twice the variance;
its nugget equals the nugget of a residual, which also compares two scans. Half the mean square of
``r_i - r_j`` over pairs at distance h (the variogram, [1]_) is fitted by

.. math:: \gamma(h) = \nu^2 + 2 \sigma^2 \left(1 - e^{-h^2 / 2 l^2}\right) .

A shift common to all points cancels: it is bias, not noise.

References
----------
.. [1] N. Cressie, Fitting variogram models by weighted least squares, Mathematical
   Geology 17 (1985) 563-586.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import KDTree

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Volume
from palpate.workers.comparison.observation.interface import (
    GLANDULAR,
    OUTLINE,
    Interface,
    InterfacePoints,
    interface_points,
)
from palpate.workers.comparison.observation.isosurface import SMOOTH_VOXELS
from palpate.workers.comparison.observation.noise import SMALLEST_NUGGET, SegmentationNoise
from palpate.workers.comparison.observation.residual import observe, residual

BINS = 24
FEWEST_PAIRS = 1000
MOST_POINTS = 6000  # larger sets are thinned out: the number of pairs grows with the square


def from_repeat(
    first: Volume,
    second: Volume,
    interfaces: Sequence[Interface] = (OUTLINE, GLANDULAR),
    spacing_mm: float = 1.5,
    wall_margin_mm: float = 4.0,
    clear_mm: float = 0.0,
    reach_mm: float = 15.0,
    smooth_voxels: float = SMOOTH_VOXELS,
) -> SegmentationNoise:
    """Estimate the noise of a segmentation.

    Parameters
    ----------
    first, second : Volume
        Two segmentations of the same image; the order does not matter.
    interfaces : sequence of Interface
        Interfaces combined in one estimate.
    spacing_mm, wall_margin_mm, clear_mm, smooth_voxels : float
        See `workers.comparison.observation.interface.interface_points`.
    reach_mm : float
        Largest distance between paired points; three correlation lengths or more.

    Returns
    -------
    SegmentationNoise
        Noise, equal in the reference scan and the deformed scans.

    Raises
    ------
    InputError
        If the volumes do not share an interface or it is too small for the fit.
    """

    def points_at(spacing_mm: float) -> InterfacePoints:
        return interface_points(
            first, interfaces, spacing_mm, wall_margin_mm, clear_mm, smooth_voxels
        )

    points = points_at(spacing_mm)
    if len(points) > MOST_POINTS:
        wider = spacing_mm * float(np.sqrt(len(points) / MOST_POINTS))
        points = points_at(wider)
    r, _ = residual(points.points, points, observe(second, interfaces, smooth_voxels))
    h, half_square, pairs = variogram(points, r, reach_mm)
    if pairs.sum() < FEWEST_PAIRS:
        raise InputError(
            f"Only {int(pairs.sum())} pairs of interface points are within {reach_mm} mm, expected "
            f"{FEWEST_PAIRS} or more. Lower spacing_mm or wall_margin_mm."
        )
    nugget, sd_of_both, length = _fitted(h, half_square, pairs, reach_mm)
    sd = float(sd_of_both / np.sqrt(2))
    least = max(SMALLEST_NUGGET * sd, 1e-6)
    return SegmentationNoise(sd, length, sd, max(nugget, least))


def variogram(
    points: InterfacePoints, r: FloatArray, reach_mm: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return half the mean square difference between values at pairs of points, by distance.

    Parameters
    ----------
    points : InterfacePoints
        Set of k points; pairs are on the same interface with similar normals.
    r : ndarray, shape (k,)
    reach_mm : float

    Returns
    -------
    distance_mm, half_square, pairs : ndarray, shape (b,)
        Mean distance, value and number of pairs of each non-empty bin.
    """
    i, j = KDTree(points.points).query_pairs(reach_mm, output_type="ndarray").T
    same = points.interface[i] == points.interface[j]
    same &= np.einsum("pc,pc->p", points.normals[i], points.normals[j]) > 0.5
    i, j = i[same], j[same]
    h = np.linalg.norm(points.points[i] - points.points[j], axis=1)
    place = np.minimum((h / reach_mm * BINS).astype(int), BINS - 1)
    pairs = np.bincount(place, minlength=BINS).astype(float)
    held = pairs > 0
    square = np.bincount(place, 0.5 * (r[i] - r[j]) ** 2, BINS)
    return (
        np.bincount(place, h, BINS)[held] / pairs[held],
        square[held] / pairs[held],
        pairs[held],
    )


def _fitted(
    h: FloatArray, gamma: FloatArray, pairs: FloatArray, reach_mm: float
) -> tuple[float, float, float]:
    """Fit nugget, standard deviation and correlation length by weighted least squares."""

    def model(p: FloatArray) -> FloatArray:
        return np.asarray(p[0] ** 2 + p[1] ** 2 * (1 - np.exp(-0.5 * (h / p[2]) ** 2)))

    def misfit(p: FloatArray) -> FloatArray:
        # Cressie's weights: the scatter of each value is proportional to the value itself.
        return np.asarray(np.sqrt(pairs) * (gamma / np.maximum(model(p), 1e-12) - 1))

    sill = float(np.sqrt(max(gamma.max(), 1e-12)))
    bounds = ([0.0, 0.0, h[0] / 2], [2 * sill, 2 * sill, reach_mm])
    solution = least_squares(misfit, [0.2 * sill, sill, reach_mm / 4], bounds=bounds)
    nugget, sd, length = solution.x.tolist()
    return nugget, sd, length
