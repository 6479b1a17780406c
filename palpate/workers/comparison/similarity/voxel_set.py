"""Sets of voxels with a position on a lattice."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, Volume
from palpate.workers.compile_flags import EXACT

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
