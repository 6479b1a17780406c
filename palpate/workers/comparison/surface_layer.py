"""Closing of a surface layer, such as skin, where deformation thins it below a voxel.

`warp_labels` samples a deformed body at voxel centres. A layer that compression has stretched to
less than a voxel falls between two centres, one in the tissue below and one in air, and the
image shows tissue next to air. Such a voxel is detected on the line to the centre in air: if the
reference has the layer on that line, the voxel gets its label. The layer is then one voxel thick
where it is thinner, which closes it; nothing else moves, and the outline stays.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.comparison.rasterisation import (
    DeformedMesh,
    index_coordinates,
    place_on_lattice,
)
from palpate.workers.comparison.warp_volume import HALF, placed_labels, runs_and_map
from palpate.workers.kernels_and_threads import EXACT

# (x, y, z) of the six neighbours of a voxel.
NEIGHBOURS = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))
# Detects a layer of an eighth of a voxel: 0.2 mm skin in voxels of 1.5 mm.
STEPS = 8
# Edge in voxels of the blocks by which elements away from the surface are skipped.
BLOCK = 8


def warp_with_skin(
    reference: Volume, mesh: TetMesh, displacement_mm: FloatArray, lattice: Volume | None = None
) -> Volume:
    """Deform tissue labels, with skin over fat and ligament closed; see `warp_labels`.

    Glandular tissue and muscle that reach the surface keep their voxels, because these are the
    tissues that scores and interfaces compare.
    """
    placed = place_on_lattice(mesh, displacement_mm, reference if lattice is None else lattice)
    labels = placed_labels(placed, reference, mesh)
    close_layer(labels, placed, reference, mesh, Tissue.SKIN, (Tissue.FAT, Tissue.LIGAMENT))
    return placed.volume(labels, reference)


def close_layer(
    labels: NDArray[np.generic],
    placed: DeformedMesh,
    reference: Volume,
    mesh: TetMesh,
    layer: int,
    under: Sequence[int],
) -> None:
    """Close a layer on the surface of deformed labels, in place.

    Parameters
    ----------
    labels : ndarray of uint8
        From `placed_labels`, with the next three arguments.
    placed, reference, mesh
        The deformed mesh, the labels and the mesh of the undeformed body.
    layer : int
        Label of the layer.
    under : sequence of int
        Labels that it may replace.
    """
    gives_way = np.zeros(256, np.bool_)
    gives_way[list(under)] = True
    # Few voxels are at the surface, and elements without any are skipped.
    at_surface = np.zeros(labels.shape, np.bool_)
    blocks = np.zeros([-(-size // BLOCK) for size in labels.shape], np.bool_)
    _mark_surface(labels, gives_way, at_surface, blocks)
    _close(
        placed.fixed,
        placed.bits,
        placed.nodes,
        index_coordinates(mesh.nodes, reference),
        placed.tets,
        placed.runs,
        np.ascontiguousarray(reference.values),
        at_surface,
        blocks,
        layer,
        labels,
    )


@njit(**EXACT)
def _crosses(
    m: FloatArray,
    at: tuple[int, int, int],
    step: tuple[int, int, int],
    values: NDArray[np.uint8],
    layer: int,
) -> bool:
    """Return True if the line from a voxel (x, y, z) to a neighbour meets the layer before air."""
    nz, ny, nx = values.shape
    for k in range(1, STEPS + 1):
        x = at[0] + step[0] * k / STEPS
        y = at[1] + step[1] * k / STEPS
        z = at[2] + step[2] * k / STEPS
        sx = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3] + HALF
        sy = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3] + HALF
        sz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3] + HALF
        if not (0 <= sx < nx and 0 <= sy < ny and 0 <= sz < nz):
            return False
        label = values[np.int64(sz), np.int64(sy), np.int64(sx)]
        if label == layer:
            return True
        if label == 0:
            return False
    return False


@njit(**EXACT)
def _mark_surface(
    labels: NDArray[np.uint8],
    gives_way: NDArray[np.bool_],
    marked: NDArray[np.bool_],
    blocks: NDArray[np.bool_],
) -> None:
    """Mark voxels next to air whose labels may be replaced, and the blocks that contain them.

    Outside the volume is air.
    """
    nz, ny, nx = labels.shape
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                if gives_way[labels[z, y, x]] and (
                    x == 0
                    or x == nx - 1
                    or y == 0
                    or y == ny - 1
                    or z == 0
                    or z == nz - 1
                    or labels[z, y, x - 1] == 0
                    or labels[z, y, x + 1] == 0
                    or labels[z, y - 1, x] == 0
                    or labels[z, y + 1, x] == 0
                    or labels[z - 1, y, x] == 0
                    or labels[z + 1, y, x] == 0
                ):
                    marked[z, y, x] = True
                    blocks[z // BLOCK, y // BLOCK, x // BLOCK] = True


@njit(**EXACT)
def _reaches(
    fixed: NDArray[np.int64], bits: int, tets: IntArray, t: int, blocks: NDArray[np.bool_]
) -> bool:
    """Return True if the box of an element touches a marked block."""
    ends = np.empty((3, 2), np.int64)
    for axis in range(3):
        low = high = fixed[tets[t, 0], axis]
        for corner in range(1, 4):
            low = min(low, fixed[tets[t, corner], axis])
            high = max(high, fixed[tets[t, corner], axis])
        ends[axis, 0] = (low >> bits) // BLOCK
        ends[axis, 1] = min((high >> bits) // BLOCK, blocks.shape[2 - axis] - 1)
    for k in range(ends[2, 0], ends[2, 1] + 1):
        for j in range(ends[1, 0], ends[1, 1] + 1):
            for i in range(ends[0, 0], ends[0, 1] + 1):
                if blocks[k, j, i]:
                    return True
    return False


@njit(**EXACT)
def _close(
    fixed: NDArray[np.int64],
    bits: int,
    nodes: FloatArray,
    sources: FloatArray,
    tets: IntArray,
    runs: IntArray,
    values: NDArray[np.uint8],
    at_surface: NDArray[np.bool_],
    blocks: NDArray[np.bool_],
    layer: int,
    labels: NDArray[np.uint8],
) -> None:
    nz, ny, nx = labels.shape
    m = np.empty((3, 4))
    for t in range(tets.shape[0]):
        if not _reaches(fixed, bits, tets, t, blocks):
            continue
        count = runs_and_map(fixed, bits, nodes, sources, tets, t, runs, m)
        for r in range(count):
            z, y = runs[r, 0], runs[r, 1]
            for x in range(runs[r, 2], runs[r, 3]):
                if not at_surface[z, y, x]:
                    continue
                for dx, dy, dz in NEIGHBOURS:
                    i, j, k = x + dx, y + dy, z + dz
                    inside = 0 <= i < nx and 0 <= j < ny and 0 <= k < nz
                    # Only air is 0, and nothing becomes or ceases to be air here.
                    if inside and labels[k, j, i] != 0:
                        continue
                    if _crosses(m, (x, y, z), (dx, dy, dz), values, layer):
                        labels[z, y, x] = layer
                        break
