"""Adaptive meshes of a body with an inner tissue, and their smoothing and coarser meshes.

Graded tetrahedra have faces that follow the surface between two tissues (thesis section 4.4).
Their nodes are smoothed with surfaces kept in place. In a mesh hierarchy for the solver the
finest mesh is adaptive and the coarser ones are homogeneous.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.adaptive_cuts import LevelSet, cut, level_set_of
from palpate.workers.body.mesh.adaptive_lattice import Sizes, cell_levels, graded_lattice
from palpate.workers.body.mesh.body_outline import Outline, outline_of, project
from palpate.workers.body.mesh.fitted_mesh import fitted_mesh, worst_around
from palpate.workers.body.mesh.mesh_geometry import (
    compacted,
    elements_of_nodes,
    in_memory_order,
    triangle_areas_mm2,
    volumes_mm3,
    wall_nodes,
    without_nonmanifold_edges,
)
from palpate.workers.body.mesh.mesh_hierarchy import (
    STEPS_PER_CELL,
    Hierarchy,
    MeshLevel,
    add_level,
    coarser_cells,
)
from palpate.workers.body.mesh.tissue_fractions import N_TISSUES, volume_fractions
from palpate.workers.kernels_and_threads import EXACT

# Badness of a tetrahedron is M3^-3: the worst ones count most. This value means inverted.
FLAT = 1e9
FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints on the nodes.

    Parameters
    ----------
    skin : Outline
        Surface of the body.
    interface : LevelSet
        Surface of the tissue inside it.
    skin_mm, interface_mm : float
        Values of the fields on the surfaces.
    on_skin, on_interface, on_wall : ndarray of bool, shape (n,)
        Nodes that stay on a surface, and at their z. A node on two surfaces is fixed.
    """

    skin: Outline
    interface: LevelSet
    skin_mm: float
    interface_mm: float
    on_skin: BoolArray
    on_interface: BoolArray
    on_wall: BoolArray


def smoothed(mesh: TetMesh, constraints: Constraints, sweeps: int) -> TetMesh:
    """Lower the sum of badness around each node, node by node.

    A node is tried at the mean of its neighbours, part of the way there, and along the axes,
    each time projected onto its surface, and stays at the best position.

    Parameters
    ----------
    mesh : TetMesh
    constraints : Constraints
    sweeps : int
        Number of visits to every node; nodes with good tetrahedra are skipped.
    """
    nodes = mesh.nodes.copy()
    start, around = elements_of_nodes(mesh.tets, len(nodes))
    c = constraints
    kind = np.zeros(len(nodes), np.int8)
    kind[c.on_skin] = 1
    kind[c.on_interface] = 2
    kind[c.on_skin & c.on_interface] = 3
    for sweep in range(sweeps):
        _sweep(
            nodes, mesh.tets, start, around, kind, c.on_wall, 0.15 * 0.7**sweep,
            c.skin.field, c.skin.frame, c.skin_mm,
            c.interface.field, c.interface.frame, c.interface_mm,
        )  # fmt: skip
    return TetMesh(nodes, mesh.tets)


def on_levels(mesh: TetMesh, constraints: Constraints, reach: FloatArray) -> TetMesh:
    """Move nodes back onto their surfaces, unless this degrades a tetrahedron.

    Parameters
    ----------
    mesh : TetMesh
    constraints : Constraints
    reach : ndarray, shape (n,)
        Longest move of each node in mm.
    """
    nodes = mesh.nodes.copy()
    start, around = elements_of_nodes(mesh.tets, len(nodes))
    c = constraints
    for level, mm, on in (
        (c.skin, c.skin_mm, c.on_skin & ~c.on_interface),
        (c.interface, c.interface_mm, c.on_interface & ~c.on_skin),
    ):
        _to_level(
            nodes, mesh.tets, start, around, on, c.on_wall, reach, level.field, level.frame, mm
        )
    return TetMesh(nodes, mesh.tets)


@njit(**EXACT)
def _badness(nodes: FloatArray, tets: IntArray, start: IntArray, around: IntArray, v: int) -> float:
    """Return the sum of M3^-3 = (sum of squared edges)^3 / 432 det^2 around a node."""
    total = 0.0
    for a in range(start[v], start[v + 1]):
        m = around[a]
        p, q, r, s = tets[m, 0], tets[m, 1], tets[m, 2], tets[m, 3]
        ax, ay, az = nodes[q, 0] - nodes[p, 0], nodes[q, 1] - nodes[p, 1], nodes[q, 2] - nodes[p, 2]
        bx, by, bz = nodes[r, 0] - nodes[p, 0], nodes[r, 1] - nodes[p, 1], nodes[r, 2] - nodes[p, 2]
        cx, cy, cz = nodes[s, 0] - nodes[p, 0], nodes[s, 1] - nodes[p, 1], nodes[s, 2] - nodes[p, 2]
        det = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        # (a-b)^2 + (b-c)^2 + (c-a)^2 = 3 (a^2 + b^2 + c^2) - (a + b + c)^2
        squares = ax * ax + ay * ay + az * az + bx * bx + by * by + bz * bz
        squares += cx * cx + cy * cy + cz * cz
        sx, sy, sz = ax + bx + cx, ay + by + cy, az + bz + cz
        edges = 4 * squares - sx * sx - sy * sy - sz * sz
        cube = edges * edges * edges
        if det > 0.0 and det * det > 1e-9 * cube:
            total += cube / (432.0 * det * det)
        else:
            total += FLAT
    return total


@njit(**EXACT)
def _to_level(
    nodes: FloatArray,
    tets: IntArray,
    start: IntArray,
    around: IntArray,
    on: BoolArray,
    on_wall: BoolArray,
    reach: FloatArray,
    field: NDArray[np.float32],
    frame: FloatArray,
    level: float,
) -> None:
    place = np.empty(3)
    for v in range(len(nodes)):
        if not on[v] or not project(field, frame, nodes[v], level, on_wall[v], reach[v], place):
            continue
        before = worst_around(nodes, tets, start, around, v)
        old = nodes[v].copy()
        for _ in range(4):  # halve the move while it is too large
            nodes[v] = place
            if worst_around(nodes, tets, start, around, v) > min(0.9 * before, 0.3):
                break
            place = 0.5 * (place + old)
            nodes[v] = old


@njit(**EXACT)
def _sweep(
    nodes: FloatArray,
    tets: IntArray,
    start: IntArray,
    around: IntArray,
    kind: NDArray[np.int8],
    on_wall: BoolArray,
    step: float,
    skin: NDArray[np.float32],
    skin_frame: FloatArray,
    skin_mm: float,
    inner: NDArray[np.float32],
    inner_frame: FloatArray,
    inner_mm: float,
) -> None:
    trial, mean = np.empty(3), np.empty(3)
    for v in range(len(nodes)):
        if kind[v] == 3 or start[v] == start[v + 1]:
            continue
        badness = _badness(nodes, tets, start, around, v)
        # A lattice of equal cells has 1.06^3 = 1.2 at each tetrahedron.
        if badness < 1.25 * (start[v + 1] - start[v]):
            continue
        old, best = nodes[v].copy(), nodes[v].copy()
        mean[:] = 0.0
        size = 0.0
        for a in range(start[v], start[v + 1]):
            m = around[a]
            for c in range(4):
                w = tets[m, c]
                if w != v:
                    mean += nodes[w]
                    size += np.abs(nodes[w] - old).max()
        count = 3 * (start[v + 1] - start[v])
        mean = mean / count - old
        size /= count
        for move in range(9):
            if move < 3:
                trial[:] = old + mean * (1.0, 0.5, 0.2)[move]
            else:  # along the axes from the best place so far
                trial[:] = best
                trial[(move - 3) // 2] += step * size * (1.0 if move % 2 else -1.0)
            if on_wall[v]:
                trial[2] = old[2]
            if kind[v] == 1 and not project(
                skin, skin_frame, trial, skin_mm, on_wall[v], size, trial
            ):
                continue
            if kind[v] == 2 and not project(
                inner, inner_frame, trial, inner_mm, on_wall[v], size, trial
            ):
                continue
            nodes[v] = trial
            now = _badness(nodes, tets, start, around, v)
            if now < badness - 1e-6:
                badness = now
                best[:] = trial
        nodes[v] = best


ROUNDS = 3  # of volume matching and smoothing
SWEEPS = 4


@dataclass(frozen=True, eq=False)
class AdaptiveMesh:
    """Tetrahedra of two tissues, not cut by the surface between them.

    Parameters
    ----------
    mesh : TetMesh
    inside : ndarray of bool, shape (m,)
        Tetrahedra of the tissue inside.
    wall : ndarray of int32, shape (w,)
        Nodes in the plane of the chest wall.
    """

    mesh: TetMesh
    inside: BoolArray
    wall: IntArray


def adaptive_mesh(labels: Volume, sizes: Sizes, tissue: Tissue = Tissue.GLANDULAR) -> AdaptiveMesh:
    """Mesh a body so that faces follow the surface of one tissue.

    A body-centred lattice, graded 2:1 from small cells at that surface to large ones, is
    cut along the outline and along the surface. Nodes are moved to improve the tetrahedra;
    the levels of outline and surface are shifted until body and tissue have the volumes of their
    voxels. Equal input gives equal output.

    Parameters
    ----------
    labels : Volume
        `Tissue`; everything but `tissue` and air is one material.
    sizes : Sizes
    tissue : Tissue

    Raises
    ------
    InputError
        If there is no voxel of the tissue or the body, or the cells are too large for it.
    """
    if not (labels.values == tissue).any():
        raise InputError(
            f"No voxel is {tissue.name.lower()}, so there is no surface to adapt a mesh to. Use a "
            "homogeneous mesh, or check the labels."
        )
    outline = outline_of(labels, float(max(labels.spacing_mm)))
    inner = level_set_of(labels, tissue)
    mesh, inside, constraints = _cut_lattice(labels, tissue, outline, sizes, inner)
    mesh = _fitted(mesh, inside, constraints)
    mesh, rows = in_memory_order(mesh, sizes.smallest_mm)
    return AdaptiveMesh(mesh, inside[rows], wall_nodes(mesh.nodes, outline.wall_z_mm))


def _cut_lattice(
    labels: Volume, tissue: Tissue, outline: Outline, sizes: Sizes, inner: LevelSet
) -> tuple[TetMesh, BoolArray, Constraints]:
    levels, corner = cell_levels(labels, tissue, outline, sizes)
    lattice = graded_lattice(levels, corner, sizes.smallest_mm)
    on_wall = lattice.mesh.nodes[:, 2] == outline.wall_z_mm
    nobody = np.zeros(len(on_wall), np.bool_)
    body = cut(lattice.mesh, lattice.size_mm, outline, 0.0, nobody, on_wall)
    # A tetrahedron between four nodes of the skin is a flat lid over a dent.
    solid = body.inside & ~body.on_surface[body.mesh.tets].all(axis=1)
    if not solid.any():
        raise InputError(
            f"The body in the volume ({outline.volume_mm3:.3g} mm3) is too small for cells of "
            f"{sizes.skin_mm:g} mm. Use smaller cells."
        )
    kept = np.flatnonzero(solid)
    tets = body.mesh.tets[kept]
    whole = without_nonmanifold_edges(tets)
    kept = kept[_rows_in(tets, whole)]
    mesh, used = compacted(body.mesh.nodes, body.mesh.tets[kept])
    on_skin = body.on_surface[used]
    on_wall = mesh.nodes[:, 2] == outline.wall_z_mm
    both = cut(mesh, lattice.size_mm[body.parent[kept]], inner, 0.0, on_skin, on_wall)
    new_skin = on_skin[both.new_ends].all(axis=1)
    constraints = Constraints(
        outline, inner, 0.0, 0.0,
        on_skin=np.concatenate([on_skin, new_skin]),
        on_interface=both.on_surface,
        on_wall=both.mesh.nodes[:, 2] == outline.wall_z_mm,
    )  # fmt: skip
    return both.mesh, both.inside, constraints


def _fitted(mesh: TetMesh, inside: BoolArray, constraints: Constraints) -> TetMesh:
    """Alternate between smoothing and volume matching, ending with volume matching."""
    reach = 0.5 * _shortest_edge(mesh)
    for last in (*[False] * (ROUNDS - 1), True):
        mesh = smoothed(mesh, constraints, SWEEPS)
        for _ in range(2 if last else 1):
            constraints = _shifted(mesh, inside, constraints)
            mesh = on_levels(mesh, constraints, reach)
    return mesh


def _shifted(mesh: TetMesh, inside: BoolArray, c: Constraints) -> Constraints:
    """Return constraints with surfaces moved outwards by the missing volume per area."""
    volume = volumes_mm3(mesh)
    tissue = float(volume[inside].sum())
    inner_area = _area(mesh, inside, c.on_interface)
    skin_area = _area(mesh, np.ones(len(inside), np.bool_), c.on_skin)
    return replace(
        c,
        interface_mm=c.interface_mm + (c.interface.volume_mm3 - tissue) / max(inner_area, 1e-9),
        skin_mm=c.skin_mm + (c.skin.volume_mm3 - float(volume.sum())) / max(skin_area, 1e-9),
    )


def _area(mesh: TetMesh, inside: BoolArray, on: BoolArray) -> float:
    """Return the area of the faces of `inside` tetrahedra whose nodes are all on a surface."""
    faces = mesh.tets[inside][:, FACES].reshape(-1, 3)
    return float(triangle_areas_mm2(mesh.nodes, faces[on[faces].all(axis=1)]).sum())


def _shortest_edge(mesh: TetMesh) -> FloatArray:
    """Return the length of the shortest edge at each node, shape (n,)."""
    found = np.full(len(mesh.nodes), np.inf)
    for a, b in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
        p, q = mesh.tets[:, a], mesh.tets[:, b]
        length = np.linalg.norm(mesh.nodes[p] - mesh.nodes[q], axis=1)
        np.minimum.at(found, p, length)
        np.minimum.at(found, q, length)
    return found


def _rows_in(rows: IntArray, subset: IntArray) -> BoolArray:
    """Return a mask of the rows that are in a subset of them."""
    fields = [("", rows.dtype)] * rows.shape[1]
    a, b = (np.ascontiguousarray(r).view(fields).ravel() for r in (rows, subset))
    return np.isin(a, b)


def adaptive_hierarchy(
    labels: Volume, sizes: Sizes, tissue: Tissue = Tissue.GLANDULAR
) -> Hierarchy:
    """Build nested meshes, coarse to fine, of which the finest is adaptive.

    Coarser levels have tissue fractions by volume; the finest has one tissue per
    tetrahedron, `tissue` or fat.

    Parameters
    ----------
    labels : Volume
        `Tissue`; everything but `tissue` and air is fat.
    sizes : Sizes
    tissue : Tissue

    Raises
    ------
    InputError
        See `adaptive_mesh`.
    """
    two = np.where(labels.values == Tissue.AIR, Tissue.AIR, Tissue.FAT).astype(np.uint8)
    two[labels.values == tissue] = tissue
    materials = replace(labels, values=two)
    fine = adaptive_mesh(materials, sizes, tissue)
    outline = outline_of(materials, 2 * sizes.smallest_mm / STEPS_PER_CELL)
    levels: list[MeshLevel] = []
    for cell_mm in reversed(coarser_cells(sizes.smallest_mm, outline.smallest_extent_mm)):
        coarse = fitted_mesh(outline, cell_mm)
        if not coarse.has_wall:
            continue  # the body touches its wall in a spot smaller than these cells
        fractions = volume_fractions(coarse.mesh, materials)
        add_level(levels, coarse.mesh, fractions, coarse.wall)
    one_hot = np.zeros((len(fine.mesh.tets), N_TISSUES), np.float32)
    one_hot[~fine.inside, Tissue.FAT] = 1
    one_hot[fine.inside, tissue] = 1
    add_level(levels, fine.mesh, one_hot, fine.wall)
    return Hierarchy(tuple(levels))
