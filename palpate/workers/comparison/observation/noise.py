r"""Scatter of interfaces due to segmentation errors.

A segmentation shifts an interface along its normal by a smooth random amount. For
two points of the same interface at the reference distance h, with normals n and n',

.. math:: K = \exp\left(-\frac{h^2}{2 l^2}\right) \frac{1 + n \cdot n'}{2} ,

so that errors on the two sides of a thin sheet are independent. Both factors, and therefore their
product (Schur), are positive semi-definite; excluding pairs of points by the sign of ``n . n'``
would break this property. Residuals of points i, j in states s, t have

.. math:: C_{si,tj} = (\sigma_{ref}^2 + \delta_{st} \sigma^2) K_{ij}
          + \delta_{st} \delta_{ij} \nu^2 :

the reference scan was segmented once, for all states, and each deformed scan separately. Where a
plate flattens the surface, the first term vanishes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.comparison.observation.interface import InterfacePoints

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
    points: InterfacePoints,
    noise: SegmentationNoise,
    states: int,
    free: FloatArray | None = None,
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
