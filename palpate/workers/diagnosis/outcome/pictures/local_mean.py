r"""Residuals averaged over a neighbourhood, for maps without the noise of single points.

The noise of a segmentation changes sign every few millimetres; a gap does not. For weights w over
the points of one interface with similar normals,

.. math:: \bar r = w'r, \qquad sd(\bar r)^2 = w' D w,

with D the covariance of the residuals, so that two standard deviations mean the same everywhere,
even near an edge of the interface.
"""

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray

LENGTH_MM = 8.0


def local_mean(
    points: FloatArray,
    normals: FloatArray,
    interface: IntArray,
    residual: FloatArray,
    covariance: FloatArray,
    length_mm: float = LENGTH_MM,
) -> tuple[FloatArray, FloatArray]:
    """Average residuals around each point.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Points of the body at rest, in mm.
    normals : ndarray, shape (k, 3)
        Unit normals there; opposite sides of a thin part are not mixed.
    interface : ndarray of int, shape (k,)
    residual : ndarray, shape (s, k)
        Residuals of each scan, in mm.
    covariance : ndarray, shape (s k, s k)
        Covariance of all residuals, with the scans concatenated, in mm^2.
    length_mm : float
        Standard deviation of the Gaussian weights; > 0.

    Returns
    -------
    mean, sd : ndarray, shape (s, k)
        Averages and their standard deviations in mm.

    Raises
    ------
    InputError
        If shapes do not match or the length is not positive.
    """
    s, k = residual.shape
    shapes = points.shape, normals.shape, interface.shape, covariance.shape
    if shapes != ((k, 3), (k, 3), (k,), (s * k, s * k)) or not length_mm > 0:
        raise InputError(
            f"Local means of {s} x {k} residuals need points and normals of shape ({k}, 3), "
            f"interfaces ({k},), a covariance ({s * k}, {s * k}) and a length > 0 mm, found "
            f"{shapes} and "
            f"{length_mm}."
        )
    squares = ((points[:, None] - points[None]) ** 2).sum(axis=2)
    weights = np.exp(-0.5 * squares / length_mm**2) * np.maximum(normals @ normals.T, 0.0)
    weights[interface[:, None] != interface] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    own = [covariance[i * k : (i + 1) * k, i * k : (i + 1) * k] for i in range(s)]
    variance = [((weights @ C) * weights).sum(axis=1) for C in own]
    return residual @ weights.T, np.sqrt(np.maximum(variance, 0.0))
