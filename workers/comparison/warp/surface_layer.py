"""Closing of a surface layer, such as skin, where deformation thins it below a voxel.

`warp_labels` samples a deformed body at voxel centres. A layer that compression has stretched to
less than a voxel falls between two centres, one in the tissue below and one in air, and the
image shows tissue next to air. Such a voxel is detected on the line to the centre in air: if the
reference has the layer on that line, the voxel gets its label. The layer is then one voxel thick
where it is thinner, which closes it; nothing else moves, and the outline stays.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.comparison.warp.deformed_mesh import index_coordinates, place_on_lattice
from palpate.workers.comparison.warp.warp_volume import HALF, runs_and_map, warp_labels
from palpate.workers.compile_flags import EXACT

# (x, y, z) of the six neighbours of a voxel.
NEIGHBOURS = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))
# Detects a layer of an eighth of a voxel: 0.2 mm skin in voxels of 1.5 mm.
STEPS = 8


def warp_with_skin(
    reference: Volume, mesh: TetMesh, displacement_mm: FloatArray, lattice: Volume | None = None
) -> Volume:
    """Deform tissue labels, with skin over fat and ligament closed; see `warp_labels`.

    Glandular tissue and muscle that reach the surface keep their voxels, because these are the
    tissues that scores and interfaces compare.
    """
    deformed = warp_labels(reference, mesh, displacement_mm, lattice)
    under = (Tissue.FAT, Tissue.LIGAMENT)
    return closed_layer(deformed, reference, mesh, displacement_mm, Tissue.SKIN, under)


def closed_layer(
    deformed: Volume,
    reference: Volume,
    mesh: TetMesh,
    displacement_mm: FloatArray,
    layer: int,
    under: Sequence[int],
) -> Volume:
    """Close a layer on the surface of a deformed label volume.

    Parameters
    ----------
    deformed : Volume of uint8
        From `warp_labels`.
    reference, mesh, displacement_mm
        The arguments of `warp_labels`.
    layer : int
        Label of the layer.
    under : sequence of int
        Labels that it may replace.

    Returns
    -------
    Volume
        `deformed` itself if the reference has no such layer.
    """
    values = np.ascontiguousarray(reference.values)
    if not (values == layer).any():
        return deformed
    placed = place_on_lattice(mesh, displacement_mm, deformed)
    gives_way = np.zeros(256, np.bool_)
    gives_way[list(under)] = True
    closed = np.array(deformed.values)
    _close(
        placed.fixed,
        placed.bits,
        placed.nodes,
        index_coordinates(mesh.nodes, reference),
        placed.tets,
        placed.runs,
        values,
        np.ascontiguousarray(deformed.values),
        layer,
        gives_way,
        closed,
    )
    return replace(deformed, values=closed)


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
def _close(
    fixed: NDArray[np.int64],
    bits: int,
    nodes: FloatArray,
    sources: FloatArray,
    tets: IntArray,
    runs: IntArray,
    values: NDArray[np.uint8],
    deformed: NDArray[np.uint8],
    layer: int,
    gives_way: NDArray[np.bool_],
    closed: NDArray[np.uint8],
) -> None:
    nz, ny, nx = deformed.shape
    m = np.empty((3, 4))
    for t in range(tets.shape[0]):
        count = runs_and_map(fixed, bits, nodes, sources, tets, t, runs, m)
        for r in range(count):
            z, y = runs[r, 0], runs[r, 1]
            for x in range(runs[r, 2], runs[r, 3]):
                if not gives_way[deformed[z, y, x]]:
                    continue
                for dx, dy, dz in NEIGHBOURS:
                    i, j, k = x + dx, y + dy, z + dz
                    inside = 0 <= i < nx and 0 <= j < ny and 0 <= k < nz
                    if inside and deformed[k, j, i] != 0:
                        continue
                    if _crosses(m, (x, y, z), (dx, dy, dz), values, layer):
                        closed[z, y, x] = layer
                        break
