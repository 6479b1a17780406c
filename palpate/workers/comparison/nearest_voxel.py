"""Squared distances from one set of voxels to another, without a distance map.

Near the optimum of a search most voxels are in both sets or a step apart, and
searching around each voxel is much faster than a distance map of the whole box:

1. a *miss* is a voxel of one set that is not in the other;
2. around each miss the other set is searched in order of distance, up to
   `NEAR` voxels: the first hit is the nearest;
3. the remaining misses are searched line by line: the lines along x through the
   neighbourhood, nearest first, each with the distance to its next voxel of the
   set, until a line is itself further than the best so far.

The work grows with the cube of the distance in step 2 and with its square in
step 3, so it is counted. Beyond an allowance step 2 leaves the rest to step 3, and
`squared_distances` returns None if that would cost more than a distance map.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import IntArray
from palpate.workers.comparison.voxel_set import DistanceMap, Metric, VoxelSet
from palpate.workers.kernels_and_threads import EXACT

NEAR = 12
FAR = 64
# Look-ups per voxel of the box that cost as much as preparing step 3, and as a distance map.
NEAR_LOOKS = 1.0
FAR_LOOKS = 2.0
SAMPLE = 500  # remaining misses from which the work of step 3 is estimated
NO_VOXEL = np.iinfo(np.uint16).max

Distances = NDArray[np.int64]


def squared_distances(
    queries: VoxelSet, features: VoxelSet, least_class: int, metric: Metric
) -> Distances | None:
    """Return squared distances of the misses, found by a local search.

    Parameters
    ----------
    queries, features : VoxelSet
        Not empty. Distances run from each voxel of `queries` to the nearest of `features`.
    least_class : int
        ``INTERIOR``: all voxels of both sets; ``BOUNDARY``: the boundary voxels.
    metric : Metric

    Returns
    -------
    ndarray of int64, shape (misses,), or None
        In lattice order (z slowest), without the zeros of voxels in both sets; the same as
        `squared_distances_from_map`. None if the search would cost more than a distance map.
    """
    offset = _offset(queries, features.start)
    where = _misses(queries.mask, least_class, features.mask, *offset)
    squared = np.full(where.shape[0], -1, dtype=np.int64)
    ball, squares = metric.ball(NEAR)
    allowance = int(NEAR_LOOKS * features.mask.size)
    _search_ball(where, features.mask, least_class, ball, squares, allowance, squared)
    unsolved = np.flatnonzero(squared < 0)
    if unsolved.size == 0:
        return squared
    if features.mask.shape[2] >= NO_VOXEL:
        return None
    disc, squares = metric.disc(FAR)
    gaps = _gaps(features.mask, least_class)
    sample = unsolved[:: max(1, unsolved.size // SAMPLE)]
    allowance = int(FAR_LOOKS * _union_size(queries, features))
    for part in (sample, unsolved):
        limit = allowance * part.size // unsolved.size
        if not _search_lines(part, where, gaps, disc, squares, metric.weights[2], limit, squared):
            return None
    return squared


def squared_distances_from_map(
    queries: VoxelSet, least_class: int, distances: DistanceMap
) -> Distances:
    """Return squared distances of the misses, read from a map that covers `queries`.

    Parameters
    ----------
    queries : VoxelSet
    least_class : int
        ``INTERIOR`` or ``BOUNDARY``, as for the map.
    distances : DistanceMap

    Returns
    -------
    ndarray of int64, shape (misses,)
        The same as `squared_distances`.
    """
    offset = _offset(queries, distances.start)
    return _gather(queries.mask, least_class, distances.squared, *offset)


def _offset(voxels: VoxelSet, start: tuple[int, int, int]) -> tuple[int, int, int]:
    z, y, x = (a - b for a, b in zip(voxels.start, start, strict=True))
    return z, y, x


def _union_size(a: VoxelSet, b: VoxelSet) -> int:
    ends = zip(a.start, b.start, a.stop, b.stop, strict=True)
    return int(np.prod([max(a1, b1) - min(a0, b0) for a0, b0, a1, b1 in ends]))


@njit(**EXACT)
def _misses(
    queries: NDArray[np.uint8],
    least_class: int,
    features: NDArray[np.uint8],
    oz: int,
    oy: int,
    ox: int,
) -> IntArray:
    """List (z, y, x), in the box of the features, of all query voxels that are not features."""
    nz, ny, nx = queries.shape
    fz, fy, fx = features.shape
    left, right = max(0, -ox), min(nx, fx - ox)
    where = np.empty((1024, 3), dtype=np.int32)
    count = 0
    missing = np.empty(nx, dtype=np.bool_)
    for z in range(nz):
        for y in range(ny):
            line = queries[z, y]
            total = 0
            for x in range(nx):
                missing[x] = line[x] >= least_class
            if 0 <= z + oz < fz and 0 <= y + oy < fy and left < right:
                other = features[z + oz, y + oy, left + ox : right + ox]
                part = missing[left:right]
                for x in range(right - left):
                    part[x] = part[x] & (other[x] < least_class)
            for x in range(nx):
                total += missing[x]
            if total == 0:
                continue
            if count + total > where.shape[0]:
                more = np.empty((2 * (count + total), 3), dtype=np.int32)
                more[:count] = where[:count]
                where = more
            for x in range(nx):
                if missing[x]:
                    where[count, 0] = z + oz
                    where[count, 1] = y + oy
                    where[count, 2] = x + ox
                    count += 1
    return where[:count]


@njit(**EXACT)
def _search_ball(
    where: IntArray,
    features: NDArray[np.uint8],
    least_class: int,
    ball: NDArray[np.int64],
    squares: Distances,
    allowance: int,
    squared: Distances,
) -> None:
    """Store distances within the ball, up to the allowance."""
    nz, ny, nx = features.shape
    for i in range(where.shape[0]):
        z, y, x = where[i, 0], where[i, 1], where[i, 2]
        k = 0
        while k < ball.shape[0]:
            fz, fy, fx = z + ball[k, 0], y + ball[k, 1], x + ball[k, 2]
            if (
                0 <= fz < nz
                and 0 <= fy < ny
                and 0 <= fx < nx
                and features[fz, fy, fx] >= least_class
            ):
                squared[i] = squares[k]
                break
            k += 1
        allowance -= k
        if allowance < 0:
            return


@njit(**EXACT)
def _gaps(features: NDArray[np.uint8], least_class: int) -> NDArray[np.uint16]:
    """Return distances along x to the next voxel of the set, in voxels; NO_VOXEL if none."""
    nz, ny, nx = features.shape
    gaps = np.empty((nz, ny, nx), dtype=np.uint16)
    for z in range(nz):
        for y in range(ny):
            source, line = features[z, y], gaps[z, y]
            gap = NO_VOXEL
            for x in range(nx):
                if source[x] >= least_class:
                    gap = 0
                elif gap < NO_VOXEL:
                    gap += 1
                line[x] = gap
            gap = NO_VOXEL
            for x in range(nx - 1, -1, -1):
                if source[x] >= least_class:
                    gap = 0
                elif gap < NO_VOXEL:
                    gap += 1
                if gap < line[x]:
                    line[x] = gap
    return gaps


@njit(**EXACT)
def _search_lines(
    unsolved: NDArray[np.intp],
    where: IntArray,
    gaps: NDArray[np.uint16],
    disc: NDArray[np.int64],
    squares: Distances,
    weight: int,
    allowance: int,
    squared: Distances,
) -> bool:
    """Store distances of the unsolved misses; False once a distance or the work is too large."""
    nz, ny, nx = gaps.shape
    for i in unsolved:
        z, y, x = where[i, 0], where[i, 1], where[i, 2]
        inside = min(max(x, 0), nx - 1)
        beyond = abs(x - inside)
        best = np.int64(-1)
        k = 0
        while k < disc.shape[0] and (best < 0 or squares[k] < best):
            fz, fy = z + disc[k, 0], y + disc[k, 1]
            if 0 <= fz < nz and 0 <= fy < ny:
                gap = np.int64(gaps[fz, fy, inside])
                if gap != NO_VOXEL:
                    gap += beyond
                    square = squares[k] + weight * gap * gap
                    if best < 0 or square < best:
                        best = square
            k += 1
        allowance -= k
        # At the end of the disc a line outside it may still be nearer.
        if allowance < 0 or best < 0 or (k == disc.shape[0] and best > squares[k - 1]):
            return False
        squared[i] = best
    return True


@njit(**EXACT)
def _gather(
    queries: NDArray[np.uint8],
    least_class: int,
    squared: NDArray[np.integer],
    oz: int,
    oy: int,
    ox: int,
) -> Distances:
    nz, ny, nx = queries.shape
    values = np.empty(1024, dtype=np.int64)
    count = 0
    for z in range(nz):
        for y in range(ny):
            line = queries[z, y]
            distances = squared[z + oz, y + oy, ox : ox + nx]
            if count + nx > values.shape[0]:
                more = np.empty(2 * (count + nx), dtype=np.int64)
                more[:count] = values[:count]
                values = more
            for x in range(nx):
                if line[x] >= least_class and distances[x] > 0:
                    values[count] = distances[x]
                    count += 1
    return values[:count]
