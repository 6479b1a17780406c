"""Meshes of a block: body-centred lattices of tetrahedra that reach its corners exactly.

Voxels would round the edges, and the bending stiffness of a beam grows with the third
power of its height. A lattice has a node at the corners and at the centre of each cell.
Four tetrahedra around each inner face connect the centres on its two sides (the lattice of
F. Labelle and J. R. Shewchuk, ACM Trans. Graph. 26 (2007) 57); two connect each outer face
to the centre next to it.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, TetMesh, Tissue, Triple
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles, split_boundary
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, MeshLevel
from palpate.workers.body.mesh.nodal_interpolation import prolongation

Cells = tuple[int, int, int]
Numbers = NDArray[np.int64]

FEWEST_CELLS = 4  # across the shortest side of the finest lattice
COARSEST_CELLS = 3  # across the shortest side of the coarsest lattice
# Nodes of the largest lattice that is factored directly; a larger one is halved along its long
# sides only.
MOST_FACTORED = 1000
# A block this many times wider than thick may be modelled as a sheet.
THIN = 20.0


def block(size_mm: Triple, nodes: int, tissue: Tissue = Tissue.FAT) -> Hierarchy:
    """Mesh a block with one corner at the origin.

    Parameters
    ----------
    size_mm : tuple of float
        Lengths along x, y and z, > 0.
    nodes : int
        Requested number of nodes of the finest lattice, met as closely as whole cells allow.
    tissue : Tissue
        Tissue of all elements.

    Raises
    ------
    InputError
        If there are too few nodes for four cells across the shortest side.
    """
    return lattices(size_mm, cells_of(size_mm, nodes), tissue)


def lattices(size_mm: Triple, finest: Cells, tissue: Tissue = Tissue.FAT) -> Hierarchy:
    """Mesh a block by a lattice with these cells and coarser ones, each with half as many."""
    cells = [finest]
    while (coarser := _coarser(cells[0])) is not None:
        cells.insert(0, coarser)
    meshes = [lattice(size_mm, each) for each in cells]
    walls = [np.flatnonzero(mesh.nodes[:, 2] == 0).astype(np.int32) for mesh in meshes]
    transfers = [
        prolongation(a, wall_a, b.nodes, wall_b)
        for (a, wall_a), (b, wall_b) in pairwise(zip(meshes, walls, strict=True))
    ]
    levels = []
    for mesh, wall, transfer in zip(meshes, walls, [None, *transfers], strict=True):
        fractions = np.zeros((len(mesh.tets), len(Tissue)), np.float32)
        fractions[:, tissue] = 1
        surface, _ = split_boundary(boundary_triangles(mesh.tets), wall)
        levels.append(MeshLevel(mesh, fractions, wall, surface, transfer))
    return Hierarchy(tuple(levels), float(np.cbrt(np.prod(size_mm) / np.prod(finest))))


def _coarser(cells: Cells) -> Cells | None:
    """Halve the cells, along the long sides only if the others have few; None if all have few."""
    long = [n >= 2 * COARSEST_CELLS for n in cells]
    if (not all(long) and _count(np.array(cells)) <= MOST_FACTORED) or not any(long):
        return None
    a, b, c = (round(n / 2) if halved else n for n, halved in zip(cells, long, strict=True))
    return a, b, c


def cells_of(size_mm: Triple, nodes: int) -> Cells:
    """Return the numbers of nearly cubic cells along x, y and z for a number of nodes.

    Raises
    ------
    InputError
        If there are fewer than four cells across the shortest side.
    """
    size = np.asarray(size_mm, np.float64)
    low, high = 0.0, nodes / float(size.min())  # cells per mm
    for _ in range(60):
        middle = (low + high) / 2
        fewer = _count(size * middle) < nodes
        low, high = (middle, high) if fewer else (low, middle)
    cells = np.maximum(1, np.rint(size * low)).astype(int)
    if cells.min() < FEWEST_CELLS:
        least = _count(np.rint(size / size.min() * FEWEST_CELLS))
        raise InputError(
            f"A mesh of {nodes} nodes is too coarse for a block of {list(size_mm)} mm: its "
            f"shortest side needs {FEWEST_CELLS} elements across. Ask for {least:.0f} nodes or "
            f"more{_or_a_sheet(size_mm)}."
        )
    return int(cells[0]), int(cells[1]), int(cells[2])


def _or_a_sheet(size_mm: Triple) -> str:
    """Return a hint to model a thin block as a sheet; empty for other blocks."""
    thin, middle, _ = sorted(size_mm)
    if middle < THIN * thin:
        return ""
    x, y = (f"{side:g}" for side in size_mm if side > thin)
    return f"; or describe it as a sheet: {{size_mm: [{x}, {y}], thickness_mm: {thin:g}}}"


def _count(cells: FloatArray) -> float:
    return float(np.prod(cells + 1) + np.prod(cells))


def lattice(size_mm: Triple, cells: Cells) -> TetMesh:
    """Return a body-centred lattice: first the corners of the cells, then their centres."""
    c = np.asarray(cells)
    corner, cell = _all_of(c + 1), _all_of(c)
    nodes = np.vstack([corner, cell + 0.5]) / c * np.asarray(size_mm)
    tets = [part for axis in range(3) for part in _across(c, axis)]
    return TetMesh(nodes, _oriented(nodes, np.concatenate(tets).astype(np.int32)))


def _all_of(count: Numbers) -> Numbers:
    """Return all triples below `count`, the last number running fastest, shape (n, 3)."""
    return np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, 3)


def _number(at: Numbers, count: Numbers) -> Numbers:
    """Return the indices of triples in the order of `_all_of`."""
    return np.asarray((at[:, 0] * count[1] + at[:, 1]) * count[2] + at[:, 2])


def _across(cells: Numbers, axis: int) -> list[Numbers]:
    """Return the tetrahedra at the faces normal to an axis."""
    e = np.eye(3, dtype=np.int64)
    b, d = (a for a in range(3) if a != axis)
    face = _all_of(cells + e[axis])
    ring = np.column_stack(
        [_number(face + way, cells + 1) for way in (0 * e[b], e[b], e[b] + e[d], e[d])]
    )
    first = int(np.prod(cells + 1))
    inside = (face[:, axis] > 0) & (face[:, axis] < cells[axis])
    below = first + _number(face - e[axis], cells)
    above = first + _number(face, cells)
    tetrahedra = [
        np.column_stack([below, above, ring[:, k], ring[:, (k + 1) % 4]])[inside] for k in range(4)
    ]
    # Alternate the diagonals of neighbouring outer faces, so that no direction is stiffer.
    odd = face.sum(axis=1) % 2 == 1
    ring = np.where(odd[:, None], np.roll(ring, 1, axis=1), ring)
    centre = np.where(face[:, axis] == 0, above, below)
    for corner, other in ((1, 2), (2, 3)):
        outer = np.column_stack([centre, ring[:, 0], ring[:, corner], ring[:, other]])
        tetrahedra.append(outer[~inside])
    return tetrahedra


def _oriented(nodes: FloatArray, tets: IntArray) -> IntArray:
    flipped = np.linalg.det(nodes[tets[:, 1:]] - nodes[tets[:, :1]]) < 0
    tets[flipped] = tets[flipped][:, [0, 2, 1, 3]]
    return tets
