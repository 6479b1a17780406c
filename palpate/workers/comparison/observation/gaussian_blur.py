"""Gaussian blur of voxels: axis by axis, whole lines at a time, in single precision.

Equal to `scipy.ndimage.gaussian_filter` with ``mode="nearest"`` up to single-precision rounding,
in a fifth of the time: for a scan of 8 million voxels that blur took as long as the distances to
its interfaces.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.workers.compile_flags import CONTRACTED

PIECE = 4096  # voxels of a line summed before the next, so that their neighbours stay cached

Voxels = NDArray[np.float32]


def blurred(values: Voxels, sigma: Sequence[float], reach: float) -> Voxels:
    """Return blurred voxels; beyond the volume its outermost values are continued.

    Parameters
    ----------
    values : ndarray of float32, shape (nz, ny, nx)
    sigma : sequence of float
        Standard deviation along z, y and x, in voxels; > 0.
    reach : float
        Cut-off of the Gaussian, in standard deviations.
    """
    values = np.ascontiguousarray(values, dtype=np.float32)
    for axis, width in enumerate(sigma):
        weights = half_kernel(width, reach)
        out = np.empty_like(values)
        if axis == 2:
            lines, blurred_lines = (a.reshape(-1, a.shape[2]) for a in (values, out))
            _blur_along_lines(lines, weights, blurred_lines)
        else:
            before = int(np.prod(values.shape[:axis]))
            stack = (before, values.shape[axis], -1)
            _blur_across_lines(values.reshape(stack), weights, out.reshape(stack))
        values = out
    return values


def half_kernel(sigma: float, reach: float) -> Voxels:
    """Return the weights of a voxel and of its neighbours on one side, shape (r + 1,)."""
    radius = int(reach * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(radius + 1) / sigma) ** 2)
    return np.asarray(weights / (weights[0] + 2 * weights[1:].sum()), np.float32)


@njit(**CONTRACTED)
def _blur_across_lines(values: Voxels, weights: Voxels, out: Voxels) -> None:
    """Blur along the middle axis of (a, n, b): lines of b are weighted sums of such lines."""
    n, b = values.shape[1:]
    for a in range(values.shape[0]):
        for first in range(0, b, PIECE):
            end = min(first + PIECE, b)
            for i in range(n):
                line = out[a, i][first:end]
                line[:] = weights[0] * values[a, i][first:end]
                for k in range(1, len(weights)):
                    before = values[a, max(i - k, 0)][first:end]
                    after = values[a, min(i + k, n - 1)][first:end]
                    _add(weights[k], before, after, line)


@njit(**CONTRACTED)
def _blur_along_lines(values: Voxels, weights: Voxels, out: Voxels) -> None:
    """Blur along the last axis of (a, n)."""
    n, radius = values.shape[1], len(weights) - 1
    padded = np.empty(n + 2 * radius, np.float32)
    for a in range(values.shape[0]):
        padded[:radius] = values[a, 0]
        padded[radius : radius + n] = values[a]
        padded[radius + n :] = values[a, n - 1]
        line = out[a]
        line[:] = weights[0] * values[a]
        for k in range(1, radius + 1):
            _add(weights[k], padded[radius - k :], padded[radius + k :], line)


@njit(**CONTRACTED)
def _add(weight: np.float32, before: Voxels, after: Voxels, line: Voxels) -> None:
    for x in range(len(line)):
        line[x] += weight * (before[x] + after[x])
