r"""Scatter of interfaces due to segmentation errors, and its estimate from a repeated segmentation.

A segmentation shifts an interface along its normal by a smooth random amount. For two points of
the same interface at the reference distance h, with normals n and n',

.. math:: K = \exp\left(-\frac{h^2}{2 l^2}\right) \frac{1 + n \cdot n'}{2} ,

so that errors on the two sides of a thin sheet are independent. Both factors, and therefore
their product (Schur), are positive semi-definite; excluding pairs of points by the sign of ``n .
n'`` would break this property. Residuals of points i, j in states s, t have

.. math:: C_{si,tj} = (\sigma_{ref}^2 + \delta_{st} \sigma^2) K_{ij}
          + \delta_{st} \delta_{ij} \nu^2 :

the reference scan was segmented once, for all states, and each deformed scan separately. Where a
plate flattens the surface, the first term vanishes.

The noise is estimated from two segmentations of one image. Both scatter about the truth, so the
signed distance r from one to the other has twice the variance; its nugget equals the nugget of a
residual, which also compares two scans. Half the mean square of ``r_i - r_j`` over pairs at
distance h (the variogram, [1]_) is fitted by

.. math:: \gamma(h) = \nu^2 + 2 \sigma^2 \left(1 - e^{-h^2 / 2 l^2}\right) .

A shift common to all points cancels: it is bias, not noise.

References
----------
.. [1] N. Cressie, Fitting variogram models by weighted least squares, Mathematical
   Geology 17 (1985) 563-586.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Volume
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    Interface,
    InterfacePoints,
    interface_points,
    observe,
    residual,
)
from palpate.workers.comparison.observation.isosurface import SMOOTH_VOXELS

SMALLEST_NUGGET = 1e-3  # of the largest standard deviation; if smaller, Cholesky may fail


@dataclass(frozen=True, slots=True)
class SegmentationNoise:
    """Random error of interfaces along their normals.

    Parameters
    ----------
    sd_mm : float
        Standard deviation in each deformed scan; >= 0.
    correlation_mm : float
        Length l of the correlation ``exp(-h^2 / 2 l^2)``; > 0.
    reference_sd_mm : float
        Standard deviation in the reference scan; >= 0.
    nugget_mm : float
        Standard deviation of the independent error of each residual, from both scans: the effect of
        the voxels on an interface, some 0.08 of a voxel. At least a thousandth of the larger of the
        other two.

    Raises
    ------
    InputError
        If a number is outside these bounds.
    """

    sd_mm: float
    correlation_mm: float
    reference_sd_mm: float
    nugget_mm: float

    def __post_init__(self) -> None:
        numbers = (self.sd_mm, self.correlation_mm, self.reference_sd_mm, self.nugget_mm)
        least = SMALLEST_NUGGET * max(self.sd_mm, self.reference_sd_mm)
        if not (
            np.isfinite(numbers).all()
            and min(self.sd_mm, self.reference_sd_mm) >= 0
            and self.correlation_mm > 0
            and 0 < self.nugget_mm >= least
        ):
            raise InputError(
                "Segmentation noise needs finite deviations, and an error at each point and a "
                f"correlation length above zero; found {self.sd_mm:g} mm in the loaded scans and "
                f"{self.reference_sd_mm:g} mm at rest, {self.nugget_mm:g} mm at each point, "
                f"correlated over {self.correlation_mm:g} mm. Check the units and voxel sizes of "
                "the scans, and the noise given in their file."
            )


def correlation(points: InterfacePoints, correlation_mm: float) -> FloatArray:
    """Return the correlation K of the smooth part; see the module docstring.

    Parameters
    ----------
    points : InterfacePoints
        k points.
    correlation_mm : float

    Returns
    -------
    ndarray, shape (k, k)
        Ones on the diagonal, zeros between different interfaces.
    """
    matrix = np.asarray(cdist(points.points, points.points, "sqeuclidean"))
    matrix *= -0.5 / correlation_mm**2
    np.exp(matrix, out=matrix)
    matrix *= 0.5 + 0.5 * (points.normals @ points.normals.T)
    matrix[points.interface[:, None] != points.interface] = 0.0
    return matrix


def covariance(
    points: InterfacePoints, noise: SegmentationNoise, states: int, free: FloatArray | None = None
) -> FloatArray:
    """Return the covariance of the residuals of all states.

    Parameters
    ----------
    points : InterfacePoints
        k points.
    noise : SegmentationNoise
    states : int
        Number of deformed scans; >= 1.
    free : ndarray, shape (states, k), optional
        Fraction of the reference scan's error that each point keeps, 0 to 1; 1 by default.

    Returns
    -------
    ndarray, shape (states * k, states * k)
        Covariance in mm^2, positive definite; row ``s * k + i`` is point i in state s. It occupies
        ``8 (states k)^2`` bytes.

    Raises
    ------
    InputError
        If there are no states.
    """
    if states < 1:
        raise InputError(f"A covariance needs at least one deformed scan, found {states}.")
    k = len(points)
    smooth = correlation(points, noise.correlation_mm)
    matrix = np.empty((states, k, states, k))
    for s in range(states):
        for t in range(states):
            own = noise.sd_mm**2 if s == t else 0.0
            carried = 1.0 if free is None else free[s][:, None] * free[t]
            np.multiply(smooth, noise.reference_sd_mm**2 * carried + own, out=matrix[s, :, t])
    flat = np.asarray(matrix.reshape(states * k, states * k))
    flat[np.diag_indices(states * k)] += noise.nugget_mm**2
    return flat


BINS = 24
FEWEST_PAIRS = 1000
MOST_POINTS = 6000  # larger sets are thinned out: the number of pairs grows with the square


def noise_from_repeat(
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
        See `workers.comparison.observation.interface_residual.interface_points`.
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
    nugget, sd_of_both, length = _fitted_variogram(h, half_square, pairs, reach_mm)
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


def _fitted_variogram(
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
