"""Sets of voxels on a lattice, and exact squared distances to them in whole numbers.

Whole numbers add without rounding, so every method of finding a nearest voxel gives the same
squared distance, bit for bit, and can be chosen for speed alone.

The distance map takes one axis after the other [1]_ [2]_: along x the distance to the next voxel
of the set on the same line, then along y and z the lower envelope of the parabolas of the voxels
of a line. All sums and the crossings of parabolas are whole numbers, so nothing is rounded.

References
----------
.. [1] A. Meijster, J. Roerdink, W. Hesselink, A general algorithm for computing
   distance transforms in linear time, 2000.
.. [2] P. Felzenszwalb, D. Huttenlocher, Distance transforms of sampled
   functions, Theory of Computing 8, 2012.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, Triple, Volume
from palpate.workers.kernels_and_threads import EXACT, EXACT_UNCHECKED

# Small whole weights represent a spacing ratio such as 0.2 : 0.5 exactly.
MAX_SMALL_UNIT = 1000
SMALL_UNIT_TOLERANCE = 1e-10
# Any other is rounded to 2**-24 of the finest; images of up to 2**13 voxels fit in 62 bits.
FINE_BITS = 24
SIZE_BITS = 13


@dataclass(frozen=True)
class Metric:
    """The squared distance ``wz dz**2 + wy dy**2 + wx dx**2`` of two voxels.

    Parameters
    ----------
    weights : tuple of int
        (wz, wy, wx); the smallest is the square of the finest spacing.
    unit_mm : float
        Millimetres per unit of distance, the root of a squared distance of 1.
    """

    weights: tuple[int, int, int]
    unit_mm: float

    @classmethod
    def of_spacing(cls, spacing_mm: Triple) -> "Metric":
        """Return the metric for a spacing (x, y, z), accurate to 1e-7 or better.

        Isotropic voxels and small ratios of squared spacings are exact.
        """
        finest = min(spacing_mm)
        squares = np.array([(s / finest) ** 2 for s in reversed(spacing_mm)])
        for unit in range(1, MAX_SMALL_UNIT + 1):
            scaled = squares * unit
            if np.all(np.abs(scaled - np.rint(scaled)) <= SMALL_UNIT_TOLERANCE * scaled):
                break
        else:
            room = 62 - 4 - 2 * SIZE_BITS - int(np.ceil(np.log2(squares.max())))
            unit = 2 ** max(0, min(FINE_BITS, room))
        wz, wy, wx = (int(w) for w in np.rint(squares * unit))
        return cls((wz, wy, wx), float(finest / np.sqrt(unit)))

    def ball(self, radius: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """List offsets to all voxels within `radius` times the finest spacing, nearest first.

        Returns
        -------
        ndarray of int64, shape (k, 3)
            Offsets (dz, dy, dx), without (0, 0, 0).
        ndarray of int64, shape (k,)
            Squared lengths of the offsets, ascending.
        """
        return _nearest_first(self.weights, radius**2 * min(self.weights))

    def disc(self, radius: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """List offsets (dz, dy) to lines along x within `radius`, nearest first, with (0, 0)."""
        offsets, squares = _nearest_first(self.weights[:2], radius**2 * min(self.weights))
        zero = np.zeros((1, 2), dtype=np.int64)
        return np.concatenate([zero, offsets]), np.concatenate([zero[0, :1], squares])


@lru_cache(maxsize=8)
def _nearest_first(
    weights: tuple[int, ...], limit: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """List all nonzero offsets with a squared length up to a limit, and their squared lengths."""
    reach = [np.arange(-k, k + 1) for k in (math.isqrt(limit // w) for w in weights)]
    offsets = np.stack(np.meshgrid(*reach, indexing="ij"), axis=-1).reshape(-1, len(weights))
    squares = offsets.astype(np.int64) ** 2 @ np.array(weights, dtype=np.int64)
    order = np.argsort(squares, kind="stable")
    order = order[(squares[order] <= limit) & (squares[order] > 0)]
    arrays = offsets[order].astype(np.int64), squares[order]
    for array in arrays:
        array.setflags(write=False)  # cached and shared
    return arrays


Index = tuple[int, int, int]

# Values of a mask. A voxel belongs to the set if it is not OUTSIDE.
OUTSIDE, INTERIOR, BOUNDARY = 0, 1, 2


@dataclass(frozen=True, eq=False)
class VoxelSet:
    """Set of voxels in its tight bounding box.

    Parameters
    ----------
    mask : ndarray of uint8, shape (nz, ny, nx)
        0 not in the set, 1 interior, 2 boundary: a voxel of the set with a face
        neighbour that is not in it. Beyond the edge of an image there is no
        tissue, so a voxel at the edge is a boundary voxel.
    start : tuple of int
        Lattice index (z, y, x) of ``mask[0, 0, 0]``.
    count, boundary_count : int
        Number of voxels, and of boundary voxels among them.
    """

    mask: NDArray[np.uint8]
    start: Index
    count: int
    boundary_count: int

    @property
    def stop(self) -> Index:
        """Return one past the last lattice index along z, y and x."""
        (z, y, x), (nz, ny, nx) = self.start, self.mask.shape
        return z + nz, y + ny, x + nx


def voxel_set(volume: Volume, labels: Iterable[int], lattice: Volume) -> VoxelSet:
    """Collect the voxels that have one of some labels.

    Parameters
    ----------
    volume : Volume
        Labels, whole numbers from 0 to 255.
    labels : iterable of int
        Labels of the set; not AIR, which fills everything outside the boxes.
    lattice : Volume
        Its first voxel has lattice index (0, 0, 0).

    Returns
    -------
    VoxelSet
        Of size zero along every axis if no voxel has the labels.

    Raises
    ------
    InputError
        If the voxel centres of `volume` are not on `lattice`, or its values are
        not labels.
    """
    if not volume.on_lattice_of(lattice):
        raise InputError(
            f"The volumes are on different lattices: one has voxels of {volume.spacing_mm} mm from "
            f"{volume.origin_mm} mm, the other voxels of {lattice.spacing_mm} mm from "
            f"{lattice.origin_mm} mm. Resample one of them, or deform onto the lattice of the "
            "target."
        )
    values = _as_labels(volume.values)
    wanted = np.zeros(256, dtype=np.bool_)
    wanted[list(labels)] = True
    z0, z1, y0, y1, x0, x1 = _bounds(values, wanted)
    crop = values[z0:z1, y0:y1, x0:x1]
    mask, count, boundary_count = _classify(crop, wanted)
    shift = np.rint(
        (np.asarray(volume.origin_mm) - lattice.origin_mm) / np.asarray(lattice.spacing_mm)
    ).astype(int)
    sx, sy, sz = shift.tolist()
    return VoxelSet(mask, (sz + z0, sy + y0, sx + x0), int(count), int(boundary_count))


def _as_labels(values: NDArray[np.generic]) -> NDArray[np.uint8]:
    if values.dtype == np.uint8:
        return np.ascontiguousarray(values)
    if values.dtype.kind not in "biu":
        raise InputError(
            f"Labels must be whole numbers, got values of type {values.dtype}. "
            "Segment the image first, or relabel it."
        )
    if values.size and (int(values.min()) < 0 or int(values.max()) > 255):
        raise InputError(
            f"Labels are numbers from 0 to 255, got values from {values.min()} to "
            f"{values.max()}. Relabel the image first."
        )
    return np.ascontiguousarray(values, dtype=np.uint8)


@njit(**EXACT)
def _bounds(values: NDArray[np.uint8], wanted: BoolArray) -> tuple[int, int, int, int, int, int]:
    """Return half-open ranges along z, y, x that contain all wanted voxels; empty if none."""
    nz, ny, nx = values.shape
    z0, z1, y0, y1, x0, x1 = nz, 0, ny, 0, nx, 0
    for z in range(nz):
        for y in range(ny):
            line = values[z, y]
            first = 0
            while first < nx and not wanted[line[first]]:
                first += 1
            if first == nx:
                continue
            z0, z1 = min(z0, z), z + 1
            y0, y1 = min(y0, y), max(y1, y + 1)
            x0 = min(x0, first)
            last = nx
            while last > x1 and not wanted[line[last - 1]]:
                last -= 1
            x1 = max(x1, last)
    if z1 == 0:
        return 0, 0, 0, 0, 0, 0
    return z0, z1, y0, y1, x0, x1


@njit(**EXACT)
def _classify(values: NDArray[np.uint8], wanted: BoolArray) -> tuple[NDArray[np.uint8], int, int]:
    nz, ny, nx = values.shape
    inside = np.zeros((nz + 2, ny + 2, nx + 2), dtype=np.uint8)  # padded by one voxel
    for z in range(nz):
        for y in range(ny):
            source = values[z, y]
            line = inside[z + 1, y + 1]
            for x in range(nx):
                line[x + 1] = wanted[source[x]]
    mask = np.empty((nz, ny, nx), dtype=np.uint8)
    count = 0
    boundary = 0
    for z in range(nz):
        for y in range(ny):
            here = inside[z + 1, y + 1]
            up, down = inside[z, y + 1], inside[z + 2, y + 1]
            back, front = inside[z + 1, y], inside[z + 1, y + 2]
            line = mask[z, y]
            here_count = 0
            interior_count = 0
            for x in range(nx):
                own = here[x + 1]
                enclosed = (
                    own
                    & here[x]
                    & here[x + 2]
                    & up[x + 1]
                    & down[x + 1]
                    & back[x + 1]
                    & front[x + 1]
                )
                line[x] = own + own - enclosed
                here_count += own
                interior_count += enclosed
            count += here_count
            boundary += here_count - interior_count
    return mask, count, boundary


# Adjacent lines that share cache lines while they are copied out and back.
TILE = 16


@dataclass(frozen=True, eq=False)
class DistanceMap:
    """Squared distances in a box.

    Parameters
    ----------
    squared : ndarray of int32 or int64, shape (nz, ny, nx)
        In units of the metric, see `workers.comparison.voxel_set`.
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
            edge = begin[top]
            v = owner[top]
            if f[v] + weight * (edge - v) * (edge - v) <= fu + weight * (edge - u) * (edge - u):
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
