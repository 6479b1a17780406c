"""Exact squared distance map to a set of voxels, in whole numbers.

One axis after the other [1]_ [2]_: along x the distance to the next voxel of the
set on the same line, then along y and z the lower envelope of the parabolas of
the voxels of a line. All sums and the crossings of parabolas are whole
numbers, so nothing is rounded.

References
----------
.. [1] A. Meijster, J. Roerdink, W. Hesselink, A general algorithm for computing
   distance transforms in linear time, 2000.
.. [2] P. Felzenszwalb, D. Huttenlocher, Distance transforms of sampled
   functions, Theory of Computing 8, 2012.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.workers.comparison.similarity.voxel_metric import Metric
from palpate.workers.comparison.similarity.voxel_set import Index, VoxelSet
from palpate.workers.compile_flags import EXACT, EXACT_UNCHECKED

# Adjacent lines that share cache lines while they are copied out and back.
TILE = 16


@dataclass(frozen=True, eq=False)
class DistanceMap:
    """Squared distances in a box.

    Parameters
    ----------
    squared : ndarray of int32 or int64, shape (nz, ny, nx)
        In units of the metric, see `workers.comparison.similarity.voxel_metric`.
    start : tuple of int
        Lattice index (z, y, x) of ``squared[0, 0, 0]``.
    """

    squared: NDArray[np.integer]
    start: Index

    def covers(self, voxels: VoxelSet) -> bool:
        """Return True if the whole box of a set is inside the map."""
        stop = (a + n for a, n in zip(self.start, self.squared.shape, strict=True))
        return all(a <= b for a, b in zip(self.start, voxels.start, strict=True)) and all(
            b <= a for a, b in zip(stop, voxels.stop, strict=True)
        )


def distance_map(
    features: VoxelSet, least_class: int, metric: Metric, start: Index, stop: Index
) -> DistanceMap:
    """Return the squared distance of every voxel of a box to the nearest voxel of a set.

    Parameters
    ----------
    features : VoxelSet
        Not empty; its box is inside the requested box.
    least_class : int
        ``INTERIOR`` to measure to all voxels of the set, ``BOUNDARY`` to its
        boundary voxels.
    metric : Metric
    start, stop : tuple of int
        Half-open box of lattice indices (z, y, x).

    Returns
    -------
    DistanceMap
        4 bytes per voxel, or 8 if the numbers require it.

    Raises
    ------
    InputError
        If the box is too large for 64-bit squared distances.
    """
    shape = tuple(b - a for a, b in zip(start, stop, strict=True))
    largest = sum(w * (n - 1) ** 2 for w, n in zip(metric.weights, shape, strict=True))
    if largest >= 2**61:
        raise InputError(
            f"Distances in a box of {shape} voxels (z, y, x) with squared spacings in the ratio "
            f"{metric.weights} exceed 64-bit whole numbers. Resample to more even voxels."
        )
    dtype = np.int32 if largest < np.iinfo(np.int32).max else np.int64
    squared = np.empty(shape, dtype=dtype)
    oz, oy, ox = (a - b for a, b in zip(features.start, start, strict=True))
    wz, wy, wx = metric.weights
    far = np.iinfo(dtype).max
    _along_x(features.mask, least_class, oz, oy, ox, wx, far, squared)
    _along_y(squared, wy, far)
    _along_z(squared, wz, far)
    return DistanceMap(squared, start)


@njit(**EXACT)
def _along_x(
    mask: NDArray[np.uint8],
    least_class: int,
    oz: int,
    oy: int,
    ox: int,
    weight: int,
    far: int,
    out: NDArray[np.integer],
) -> None:
    nz, ny, nx = out.shape
    gap = np.empty(nx, dtype=np.int64)
    for z in range(nz):
        for y in range(ny):
            line = out[z, y]
            inside = oz <= z < oz + mask.shape[0] and oy <= y < oy + mask.shape[1]
            last = -1
            if inside:
                source = mask[z - oz, y - oy]
                for x in range(nx):
                    if ox <= x < ox + mask.shape[2] and source[x - ox] >= least_class:
                        last = x
                    gap[x] = x - last if last >= 0 else nx
            if last < 0:
                line[:] = far
                continue
            following = nx + nx
            for x in range(nx - 1, -1, -1):
                if gap[x] == 0:
                    following = x
                nearest = min(gap[x], following - x)
                line[x] = weight * nearest * nearest


@njit(**EXACT_UNCHECKED)
def _envelope(
    f: NDArray[np.int64],
    n: int,
    weight: int,
    far: int,
    owner: NDArray[np.int64],
    begin: NDArray[np.int64],
    out: NDArray[np.integer],
) -> bool:
    """Store ``out[i] = min over j of f[j] + weight (i - j)**2``; False if every f is far."""
    top = -1
    for u in range(n):
        fu = f[u]
        if fu == far:
            continue
        while top >= 0:
            at = begin[top]
            v = owner[top]
            if f[v] + weight * (at - v) * (at - v) <= fu + weight * (at - u) * (at - u):
                break
            top -= 1
        if top < 0:
            top = 0
            owner[0] = u
            begin[0] = 0
        else:
            v = owner[top]
            # Both parabolas are at their level or higher here, so the quotient is >= 0.
            cross = (weight * (u * u - v * v) + fu - f[v]) // (2 * weight * (u - v)) + 1
            if cross < n:
                top += 1
                owner[top] = u
                begin[top] = cross
    if top < 0:
        return False
    end = n
    for k in range(top, -1, -1):
        v = owner[k]
        fv = f[v]
        for i in range(begin[k], end):
            out[i] = fv + weight * (i - v) * (i - v)
        end = begin[k]
    return True


@njit(**EXACT)
def _along_y(squared: NDArray[np.integer], weight: int, far: int) -> None:
    for z in range(squared.shape[0]):
        _columns(squared[z], weight, far)


@njit(**EXACT)
def _along_z(squared: NDArray[np.integer], weight: int, far: int) -> None:
    for y in range(squared.shape[1]):
        _columns(squared[:, y], weight, far)


@njit(**EXACT)
def _columns(plane: NDArray[np.integer], weight: int, far: int) -> None:
    """Replace every column of a plane by its lower envelope."""
    n, nx = plane.shape
    tile = np.empty((TILE, n), dtype=np.int64)
    out = np.empty((TILE, n), dtype=np.int64)
    owner = np.empty(n, dtype=np.int64)
    begin = np.empty(n, dtype=np.int64)
    for x0 in range(0, nx, TILE):
        width = min(TILE, nx - x0)
        for i in range(n):
            for k in range(width):
                tile[k, i] = plane[i, x0 + k]
        for k in range(width):
            if not _envelope(tile[k], n, weight, far, owner, begin, out[k]):
                out[k, :] = far
        for i in range(n):
            for k in range(width):
                plane[i, x0 + k] = out[k, i]
