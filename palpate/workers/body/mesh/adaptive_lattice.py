"""Body-centred tetrahedra of a graded octree: small along surfaces, without hanging nodes.

The cells of the octree are fine where required; neighbours differ by a factor of two at most.
Every leaf has a node at its centre, and its faces are surrounded by tetrahedra (F. Labelle and
J. R. Shewchuk, "Isosurface stuffing", ACM Trans. Graph. 26 (2007), section 3):

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
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, minimum_filter

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.body_outline import Outline
from palpate.workers.body.mesh.mesh_geometry import volumes_mm3
from palpate.workers.kernels_and_threads import EXACT

Levels = NDArray[np.uint8]


def graded_levels(largest: Levels) -> Levels:
    """Return the level of the leaf that contains each of the smallest cells.

    A leaf of level l is an aligned cube of 2^l smallest cells along each edge. Leaves
    that share a face, an edge or a corner differ by one level at most.

    Parameters
    ----------
    largest : ndarray of uint8, shape (nz, ny, nx)
        Largest level allowed at each smallest cell; every side is a multiple of two to
        the power of the largest of them.

    Returns
    -------
    ndarray of uint8, shape (nz, ny, nx)

    Raises
    ------
    InputError
        If the sides do not fit the levels.
    """
    top = int(largest.max(initial=0))
    if any(side % 2**top for side in largest.shape):
        raise InputError(
            f"Cells of level {top} need sides that are multiples of {2**top}, got {largest.shape}."
        )
    levels = np.zeros(largest.shape, np.uint8)
    allowed = largest
    covered: BoolArray = np.ones(largest.shape, np.bool_)  # by leaves of this level or above
    for level in range(1, top + 1):
        allowed = _of_eight(allowed, np.minimum)
        complete = _of_eight(covered, np.logical_and)
        around = minimum_filter(complete, size=3, mode="constant", cval=1)
        covered = (allowed >= level) & around
        size = 2**level
        leaf = covered.repeat(size, 0).repeat(size, 1).repeat(size, 2)
        levels[leaf] = level
    return levels


def _of_eight(values: NDArray[Any], combine: np.ufunc) -> NDArray[Any]:
    """Combine the values of the eight children of each cell of the next level."""
    for axis in range(3):
        even = tuple(slice(0, None, 2) if a == axis else slice(None) for a in range(3))
        odd = tuple(slice(1, None, 2) if a == axis else slice(None) for a in range(3))
        values = combine(values[even], values[odd])
    return values


@dataclass(frozen=True)
class Sizes:
    """Sizes of lattice cells; edges are 0.87 to 1 times as long.

    All but the first are rounded down to `smallest_mm` times 1, 2, 4, ...

    Parameters
    ----------
    smallest_mm : float
        Size along the surface of the tissue inside.
    skin_mm : float
        Size at the outline of the body.
    largest_mm : float
        Size away from surfaces.

    Raises
    ------
    InputError
        If the sizes are not 0 < smallest <= skin <= largest.
    """

    smallest_mm: float
    skin_mm: float = 2.5
    largest_mm: float = 5.0

    def __post_init__(self) -> None:
        sizes = (self.smallest_mm, self.skin_mm, self.largest_mm)
        if not (0 < self.smallest_mm <= self.skin_mm <= self.largest_mm):
            raise InputError(
                "An adaptive mesh needs 0 < smallest <= skin <= largest size, got "
                f"{', '.join(f'{size:g}' for size in sizes)} mm."
            )

    def level_of(self, size_mm: float) -> int:
        """Return the largest level of cells not larger than a size."""
        return int(np.floor(np.log2(size_mm / self.smallest_mm) + 1e-9))


def cell_levels(
    labels: Volume, tissue: Tissue, outline: Outline, sizes: Sizes
) -> tuple[Levels, FloatArray]:
    """Return the levels of the smallest cells around a body, and the lowest corner of the first.

    Parameters
    ----------
    labels : Volume
    tissue : Tissue
        Tissue whose surface gets the smallest cells.
    outline : Outline
        Outline of the body.
    sizes : Sizes
    """
    h, top = sizes.smallest_mm, sizes.level_of(sizes.largest_mm)
    block = 2**top
    extent = outline.upper_mm - outline.lower_mm
    blocks = np.ceil(extent / (h * block)).astype(np.int64) + 2
    blocks[2] -= 1  # nothing is needed below the wall
    count = blocks * block
    corner = 0.5 * (outline.lower_mm + outline.upper_mm) - 0.5 * count * h
    corner[2] = outline.wall_z_mm
    largest = np.full((int(count[2]), int(count[1]), int(count[0])), top, np.uint8)

    marks = [
        (_faces_mm(labels, labels.values != Tissue.AIR), sizes.level_of(sizes.skin_mm)),
        (_faces_mm(labels, labels.values == tissue), 0),
    ]
    for places, level in marks:
        cells = _cells_at(places, corner, h * 2**level, [n // 2**level for n in largest.shape])
        size = 2**level
        near = _grown(cells).repeat(size, 0).repeat(size, 1).repeat(size, 2)
        largest[near] = np.minimum(largest[near], level)
    return graded_levels(largest), corner


def _grown(cells: BoolArray) -> BoolArray:
    return np.asarray(binary_dilation(cells, np.ones((3, 3, 3), np.bool_)))


def _cells_at(places: FloatArray, corner: FloatArray, h: float, shape: list[int]) -> BoolArray:
    """Return a mask of the cells of size h that contain one of the points."""
    found = np.zeros(shape, np.bool_)
    cell = np.floor((places - corner) / h).astype(np.int64)
    cell = cell[((cell >= 0) & (cell < np.array(shape)[::-1])).all(axis=1)]
    found[cell[:, 2], cell[:, 1], cell[:, 0]] = True
    return found


def _faces_mm(labels: Volume, inside: BoolArray) -> FloatArray:
    """Return the centres of the voxel faces between inside and outside, shape (k, 3)."""
    padded = np.pad(inside, 1)
    padded[0] = padded[1]  # the tissue is continued through the wall
    found = []
    for axis in range(3):
        at = np.argwhere(np.diff(padded.view(np.int8), axis=axis))[:, ::-1] - 1.0
        at[:, 2 - axis] += 0.5
        found.append(at)
    origin, step = np.asarray(labels.origin_mm), np.asarray(labels.spacing_mm)
    return np.asarray(origin + np.concatenate(found) * step)


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
        See `workers.body.mesh.adaptive_lattice.graded_levels`.
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
    mesh = TetMesh(nodes, tets)
    inverted = volumes_mm3(mesh) < 0
    tets[inverted, 2:] = tets[inverted, :1:-1]
    return GradedLattice(mesh, cell_mm * 2.0**level)


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
