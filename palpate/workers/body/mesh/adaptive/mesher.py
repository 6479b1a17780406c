"""Adaptive meshes of a body with an inner tissue."""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.adaptive.cut import cut
from palpate.workers.body.mesh.adaptive.graded_lattice import graded_lattice
from palpate.workers.body.mesh.adaptive.level_set import LevelSet, level_set_of
from palpate.workers.body.mesh.adaptive.sizing import Sizes, cell_levels
from palpate.workers.body.mesh.adaptive.smooth import Constraints, on_levels, smoothed
from palpate.workers.body.mesh.boundary import wall_nodes, without_nonmanifold_edges
from palpate.workers.body.mesh.node_order import in_memory_order
from palpate.workers.body.mesh.outline import Outline, outline_of
from palpate.workers.body.mesh.quality import volumes_mm3

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
    skin = LevelSet(outline.field, outline.frame, outline.volume_mm3)
    inner = level_set_of(labels, tissue)
    mesh, inside, constraints = _cut_lattice(labels, tissue, outline, sizes, skin, inner)
    mesh = _fitted(mesh, inside, constraints)
    return _in_order(mesh, inside, outline.wall_z_mm, sizes.smallest_mm)


def _cut_lattice(
    labels: Volume,
    tissue: Tissue,
    outline: Outline,
    sizes: Sizes,
    skin: LevelSet,
    inner: LevelSet,
) -> tuple[TetMesh, BoolArray, Constraints]:
    levels, corner = cell_levels(labels, tissue, outline, sizes)
    lattice = graded_lattice(levels, corner, sizes.smallest_mm)
    on_wall = lattice.mesh.nodes[:, 2] == outline.wall_z_mm
    nobody = np.zeros(len(on_wall), np.bool_)
    body = cut(lattice.mesh, lattice.size_mm, skin, 0.0, nobody, on_wall)
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
    mesh, used = _compact(body.mesh.nodes, body.mesh.tets[kept])
    on_skin = body.on_surface[used]
    on_wall = mesh.nodes[:, 2] == outline.wall_z_mm
    both = cut(mesh, lattice.size_mm[body.parent[kept]], inner, 0.0, on_skin, on_wall)
    new_skin = on_skin[both.new_ends].all(axis=1)
    constraints = Constraints(
        skin, inner, 0.0, 0.0,
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
    tets = mesh.tets[inside]
    total = 0.0
    for a, b, c in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)):
        faces = tets[:, (a, b, c)]
        x = mesh.nodes[faces[on[faces].all(axis=1)]]
        total += 0.5 * float(
            np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum()
        )
    return total


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


def _compact(nodes: FloatArray, tets: IntArray) -> tuple[TetMesh, BoolArray]:
    used = np.zeros(len(nodes), np.bool_)
    used[tets] = True
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return TetMesh(nodes[used], number[tets]), used


def _in_order(mesh: TetMesh, inside: BoolArray, wall_z_mm: float, step_mm: float) -> AdaptiveMesh:
    """Return nodes and tetrahedra in memory order, see `in_memory_order`."""
    ordered = in_memory_order(mesh, step_mm)
    number = np.lexsort(mesh.nodes.T)  # nodes are distinct, so positions identify them
    place = np.lexsort(ordered.nodes.T)
    renamed = np.empty(len(number), np.int64)
    renamed[number] = place
    tets = renamed[mesh.tets]
    # The same stable order of tetrahedra as in `in_memory_order`.
    order = np.argsort(tets.min(axis=1), kind="stable")
    inside = inside[order]
    return AdaptiveMesh(ordered, inside, wall_nodes(ordered.nodes, wall_z_mm))
