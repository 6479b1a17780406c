"""Body-centred tetrahedra of a graded octree, without hanging nodes.

Every leaf has a node at its centre, and its faces are surrounded by tetrahedra
(F. Labelle and J. R. Shewchuk, "Isosurface stuffing", ACM Trans. Graph. 26 (2007), section 3):

- two equal leaves: the two centres and each edge of the face; where a finer leaf touches
  the edge, its midpoint is a node and the tetrahedron is halved there;
- a leaf and a larger one: the centre of the smaller one and the two halves of its face,
  cut from the middle of the larger face to its corner;
- a leaf and four smaller ones: its centre, the middle of its face, and each half of the
  four edges;
- a leaf at the chest wall: its centre and its lower face, halved along diagonals that
  alternate like a chess board, or in eight where a finer leaf touches.

A face is cut in the same way from either side, so neighbours fit.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray, TetMesh
from palpate.workers.body.mesh.adaptive.octree import Levels
from palpate.workers.compile_flags import EXACT


@dataclass(frozen=True, eq=False)
class GradedLattice:
    """Tetrahedra of an octree on the chest wall.

    Parameters
    ----------
    mesh : TetMesh
        Positively oriented; z of the lowest nodes is exactly the z of the wall.
    size_mm : ndarray, shape (m,)
        Size of the smaller leaf at each tetrahedron.
    """

    mesh: TetMesh
    size_mm: FloatArray


def graded_lattice(levels: Levels, corner_mm: FloatArray, cell_mm: float) -> GradedLattice:
    """Return the tetrahedra between the centres and corners of leaves.

    Parameters
    ----------
    levels : ndarray of uint8, shape (nz, ny, nx)
        See `workers.body.mesh.adaptive.octree.graded_levels`.
    corner_mm : ndarray, shape (3,)
        Lowest corner of the first smallest cell; its z is the z of the wall.
    cell_mm : float
        Size of the smallest cells.
    """
    count = _emit(levels, np.empty((0, 4), np.int64), np.empty(0, np.int8))
    keys, level = np.empty((count, 4), np.int64), np.empty(count, np.int8)
    _emit(levels, keys, level)
    # Node coordinates are multiples of half the smallest cells.
    nz, ny, nx = (2 * n + 1 for n in levels.shape)
    used = np.zeros(nz * ny * nx, np.bool_)
    used[keys.ravel()] = True
    places = np.flatnonzero(used)
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    z, rest = np.divmod(places, ny * nx)
    y, x = np.divmod(rest, nx)
    nodes = np.column_stack([x, y, z]) * (0.5 * cell_mm) + corner_mm
    tets = number[keys]
    _orient(nodes, tets)
    return GradedLattice(TetMesh(nodes, tets), cell_mm * 2.0**level)


@njit(**EXACT)
def _orient(nodes: FloatArray, tets: IntArray) -> None:
    for m in range(len(tets)):
        p, q, r, s = tets[m]
        a, b, c = nodes[q] - nodes[p], nodes[r] - nodes[p], nodes[s] - nodes[p]
        det = (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
        if det < 0:
            tets[m, 2], tets[m, 3] = s, r


@njit(**EXACT)
def _key(at: NDArray[np.int64], nx: int, ny: int) -> int:
    return (at[2] * ny + at[1]) * nx + at[0]


@njit(**EXACT)
def _split(levels: Levels, at: NDArray[np.int64], axis: int, size: int, level: int) -> bool:
    """Return True if a leaf finer than `level` touches the edge from `at` along `axis`.

    ``at`` counts smallest cells. Leaves around an edge of a leaf have its level, the one
    above or the one below, and are uniform along it.
    """
    u, v = (axis + 1) % 3, (axis + 2) % 3
    cell = at.copy()
    for du in range(2):
        for dv in range(2):
            cell[u] = at[u] - du
            cell[v] = at[v] - dv
            if (
                0 <= cell[u] < levels.shape[2 - u]
                and 0 <= cell[v] < levels.shape[2 - v]
                and levels[cell[2], cell[1], cell[0]] < level
            ):
                return True
    return False


@njit(**EXACT)
def _put(
    keys: NDArray[np.int64],
    sizes: NDArray[np.int8],
    n: int,
    level: int,
    a: int,
    b: int,
    c: int,
    d: int,
) -> int:
    if len(keys):
        keys[n, 0], keys[n, 1], keys[n, 2], keys[n, 3] = a, b, c, d
        sizes[n] = level
    return n + 1


@njit(**EXACT)
def _emit(levels: Levels, keys: NDArray[np.int64], sizes: NDArray[np.int8]) -> int:
    """Write the tetrahedra, or count them if the arrays are empty."""
    shape = np.array((levels.shape[2], levels.shape[1], levels.shape[0]))
    nx, ny = 2 * shape[0] + 1, 2 * shape[1] + 1
    n = 0
    low = np.empty(3, np.int64)
    for k in range(shape[2]):
        for j in range(shape[1]):
            for i in range(shape[0]):
                level = levels[k, j, i]
                size = 1 << level
                if i % size or j % size or k % size:
                    continue  # not the first cell of its leaf
                low[0], low[1], low[2] = i, j, k
                for axis in range(3):
                    for side in range(2):
                        n = _at_face(levels, shape, low, level, axis, side, nx, ny, keys, sizes, n)
    return n


@njit(**EXACT)
def _at_face(
    levels: Levels,
    shape: NDArray[np.int64],
    low: NDArray[np.int64],
    level: int,
    axis: int,
    side: int,
    nx: int,
    ny: int,
    keys: NDArray[np.int64],
    sizes: NDArray[np.int8],
    n: int,
) -> int:
    size = np.int64(1) << level
    u, v = (axis + 1) % 3, (axis + 2) % 3
    beyond = low.copy()
    beyond[axis] += size if side else -1
    wall = axis == 2 and side == 0 and low[2] == 0
    if not wall and not 0 <= beyond[axis] < shape[axis]:
        return n
    other = level if wall else levels[beyond[2], beyond[1], beyond[0]]
    if other == level and side == 0 and not wall:
        return n  # handled from the other leaf

    centre = _key(2 * low + size, nx, ny)
    # Corners of the face in half cells, in order around it, each followed by the next midpoint.
    corner = np.empty((4, 3), np.int64)
    for c in range(4):
        corner[c] = 2 * low
        corner[c, axis] += 2 * size * side
        corner[c, u] += 2 * size * (c == 1 or c == 2)
        corner[c, v] += 2 * size * (c >= 2)
    face = (corner[0] + corner[2]) // 2

    if other > level:  # half pyramids, from the middle of the larger face to its corner
        double = 2 * size
        for c in range(4):
            d = (c + 2) % 4
            middle = (corner[c, u] // 2) % double == size and (corner[c, v] // 2) % double == size
            if middle:
                f, w = _key(corner[c], nx, ny), _key(corner[d], nx, ny)
                for e in (1, 3):
                    m = _key(corner[(c + e) % 4], nx, ny)
                    n = _put(keys, sizes, n, level, centre, f, w, m)
        return n

    split = np.zeros(4, np.bool_)
    for c in range(4):
        along = u if c % 2 == 0 else v
        start = np.minimum(corner[c], corner[(c + 1) % 4]) // 2
        split[c] = _split(levels, start, along, size, level)
    apex = centre
    if other == level and not wall:
        far = 2 * low + size
        far[axis] += 2 * size
        apex = _key(far, nx, ny)
    elif wall and not split.any():
        odd = ((low[0] + low[1]) // size) % 2
        p, q = _key(corner[odd], nx, ny), _key(corner[1 + odd], nx, ny)
        r, s = _key(corner[2 + odd], nx, ny), _key(corner[(3 + odd) % 4], nx, ny)
        n = _put(keys, sizes, n, level, centre, p, q, r)
        return _put(keys, sizes, n, level, centre, p, r, s)
    else:
        apex = _key(face, nx, ny)
        if other < level:
            split[:] = True
    fine = level - 1 if other < level else level
    for c in range(4):
        p, q = corner[c], corner[(c + 1) % 4]
        a, b = _key(p, nx, ny), _key(q, nx, ny)
        if split[c]:
            m = _key((p + q) // 2, nx, ny)
            n = _put(keys, sizes, n, fine, centre, apex, a, m)
            n = _put(keys, sizes, n, fine, centre, apex, m, b)
        else:
            n = _put(keys, sizes, n, fine, centre, apex, a, b)
    return n
