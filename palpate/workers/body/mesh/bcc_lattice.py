"""The body-centred cubic lattice and its tetrahedra.

Two neighbouring cell centres and one edge of the face between them span a
tetrahedron: 12 per cell, all alike, edges ``a`` (two) and ``sqrt(3)/2 a``
(four), the most regular lattice of tetrahedra known (Labelle and Shewchuk,
"Isosurface stuffing", ACM Trans. Graph. 26(3), 2007). The first layer of
corners is in the wall; there the pyramid between a cell's centre and its
lower face is halved, with diagonals that alternate like a chess board.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.body.mesh.body_outline import Outline, distance_at
from palpate.workers.body.mesh.mesh_geometry import compacted
from palpate.workers.kernels_and_threads import EXACT


@dataclass(frozen=True, eq=False)
class Lattice:
    """Tetrahedra of the lattice that reach into the body.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
        Positions in mm.
    tets : ndarray of int32, shape (m, 4)
        Positively oriented; each has at least one node inside.
    distance : ndarray, shape (n,)
        Signed distance to the outline at the nodes in mm.
    wall : ndarray of bool, shape (n,)
        Nodes in the plane of the wall.
    cell_mm : float
        Size of a cubic cell.
    """

    nodes: FloatArray
    tets: IntArray
    distance: FloatArray
    wall: "np.ndarray[tuple[int], np.dtype[np.bool_]]"
    cell_mm: float


def bcc_lattice(outline: Outline, cell_mm: float) -> Lattice:
    """Cover a body with the lattice, centred on the body and aligned to the wall."""
    extent = outline.upper_mm - outline.lower_mm
    cells = np.ceil(extent / cell_mm).astype(np.int64) + 2
    cells[2] -= 1  # nothing is needed below the wall
    corner = 0.5 * (outline.lower_mm + outline.upper_mm) - 0.5 * cells * cell_mm
    corner[2] = outline.wall_z_mm
    nodes, distance = _nodes(cells, corner, cell_mm, outline.field, outline.frame)
    tets = _tets(cells, distance)
    mesh, used = compacted(nodes, tets)
    layer = (cells[0] + 1) * (cells[1] + 1)
    wall = np.arange(len(nodes)) < layer
    return Lattice(mesh.nodes, mesh.tets, distance[used], wall[used], cell_mm)


@njit(**EXACT)
def _nodes(
    cells: NDArray[np.int64],
    corner: FloatArray,
    a: float,
    field: NDArray[np.float32],
    frame: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return nodes and their distances: corners first (x fastest), then centres."""
    nx, ny, nz = cells
    n_corner = (nx + 1) * (ny + 1) * (nz + 1)
    nodes = np.empty((n_corner + nx * ny * nz, 3))
    n = 0
    for half in range(2):
        for k in range(nz + 1 - half):
            for j in range(ny + 1 - half):
                for i in range(nx + 1 - half):
                    nodes[n, 0] = corner[0] + (i + 0.5 * half) * a
                    nodes[n, 1] = corner[1] + (j + 0.5 * half) * a
                    nodes[n, 2] = corner[2] + (k + 0.5 * half) * a
                    n += 1
    distance = np.empty(n)
    for m in range(n):
        distance[m] = distance_at(field, frame, nodes[m, 0], nodes[m, 1], nodes[m, 2])
    return nodes, distance


@njit(**EXACT)
def _add_if_inside(
    tets: IntArray, count: int, distance: FloatArray, p: int, q: int, r: int, s: int
) -> int:
    if distance[p] < 0 or distance[q] < 0 or distance[r] < 0 or distance[s] < 0:
        tets[count, 0], tets[count, 1], tets[count, 2], tets[count, 3] = p, q, r, s
        return count + 1
    return count


@njit(**EXACT)
def _tets(cells: NDArray[np.int64], distance: FloatArray) -> IntArray:
    nx, ny, nz = cells
    sx, sy = nx + 1, (nx + 1) * (ny + 1)
    centres = sy * (nz + 1)
    stride = np.array([1, sx, sy])  # to the next corner along x, y, z
    hop = np.array([1, nx, nx * ny])  # to the next centre
    tets = np.empty((12 * nx * ny * nz, 4), np.int32)
    count = 0
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                low = i + sx * j + sy * k
                mid = centres + i + nx * (j + ny * k)
                if k == 0:  # halve the pyramid on the wall
                    c0, c1, c2, c3 = low, low + 1, low + 1 + sx, low + sx
                    if (i + j) % 2 == 0:
                        count = _add_if_inside(tets, count, distance, c0, c1, c2, mid)
                        count = _add_if_inside(tets, count, distance, c0, c2, c3, mid)
                    else:
                        count = _add_if_inside(tets, count, distance, c1, c2, c3, mid)
                        count = _add_if_inside(tets, count, distance, c1, c3, c0, mid)
                for axis in range(3):
                    cell = (i, j, k)
                    if cell[axis] + 1 == cells[axis]:
                        continue
                    other = mid + hop[axis]
                    u, v = stride[(axis + 1) % 3], stride[(axis + 2) % 3]
                    f0 = low + stride[axis]
                    f1, f2, f3 = f0 + u, f0 + u + v, f0 + v
                    count = _add_if_inside(tets, count, distance, mid, f0, f1, other)
                    count = _add_if_inside(tets, count, distance, mid, f1, f2, other)
                    count = _add_if_inside(tets, count, distance, mid, f2, f3, other)
                    count = _add_if_inside(tets, count, distance, mid, f3, f0, other)
    return tets[:count].copy()
