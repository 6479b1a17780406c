r"""Interpolation of a field on a lattice, and of its gradient.

Cubic convolution [1]_ through four samples an axis: exact at the lattice points,
exact for quadratics, once continuously differentiable, and without a system to
solve. The gradient is the exact derivative of the interpolated field.

References
----------
.. [1] R. Keys, Cubic convolution interpolation for digital image processing,
   IEEE Trans. ASSP 29 (1981) 1153-1160, with a = -1/2.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, Triple
from palpate.workers.compile_flags import CONTRACTED


def at_points(
    values: NDArray[np.float32], spacing_mm: Triple, origin_mm: Triple, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return interpolated values and their gradients.

    Parameters
    ----------
    values : ndarray of float32, shape (nz, ny, nx)
    spacing_mm, origin_mm : tuple of float
        Along x, y, z, as in `storage.values.Volume`.
    points : ndarray, shape (k, 3)
        (x, y, z) in mm. Outside the lattice the value of the nearest point of its
        box is used, with no slope across the box.

    Returns
    -------
    value : ndarray, shape (k,)
    gradient : ndarray, shape (k, 3)
        Along x, y, z, per millimetre.
    """
    index = (points - np.asarray(origin_mm)) / np.asarray(spacing_mm)
    value, gradient = _interpolate(values, np.ascontiguousarray(index))
    return value, gradient / np.asarray(spacing_mm)


@njit(**CONTRACTED)
def _interpolate(values: NDArray[np.float32], index: FloatArray) -> tuple[FloatArray, FloatArray]:
    nz, ny, nx = values.shape
    value = np.zeros(len(index))
    gradient = np.zeros((len(index), 3))
    at = np.empty((3, 4), np.int64)
    weight = np.empty((3, 4))
    slope = np.empty((3, 4))
    for p in range(len(index)):
        _weights(index[p, 0], nx, at[0], weight[0], slope[0])
        _weights(index[p, 1], ny, at[1], weight[1], slope[1])
        _weights(index[p, 2], nz, at[2], weight[2], slope[2])
        for c in range(4):
            for b in range(4):
                line = values[at[2, c], at[1, b]]
                along = 0.0
                along_slope = 0.0
                for a in range(4):
                    along += weight[0, a] * line[at[0, a]]
                    along_slope += slope[0, a] * line[at[0, a]]
                value[p] += weight[2, c] * weight[1, b] * along
                gradient[p, 0] += weight[2, c] * weight[1, b] * along_slope
                gradient[p, 1] += weight[2, c] * slope[1, b] * along
                gradient[p, 2] += slope[2, c] * weight[1, b] * along
    return value, gradient


@njit(**CONTRACTED)
def _weights(
    where: float, n: int, at: NDArray[np.int64], weight: FloatArray, slope: FloatArray
) -> None:
    """Store four samples around a position on an axis of n, their weights and derivatives."""
    outside = where < 0.0 or where > n - 1.0
    where = min(max(where, 0.0), n - 1.0)
    first = min(int(where), max(n - 2, 0))
    t = where - first
    for k in range(4):
        at[k] = min(max(first - 1 + k, 0), n - 1)
    weight[0] = -0.5 * t + t**2 - 0.5 * t**3
    weight[1] = 1.0 - 2.5 * t**2 + 1.5 * t**3
    weight[2] = 0.5 * t + 2.0 * t**2 - 1.5 * t**3
    weight[3] = -0.5 * t**2 + 0.5 * t**3
    slope[0] = -0.5 + 2.0 * t - 1.5 * t**2
    slope[1] = -5.0 * t + 4.5 * t**2
    slope[2] = 0.5 + 4.0 * t - 4.5 * t**2
    slope[3] = -t + 1.5 * t**2
    if outside:
        slope[:] = 0.0
