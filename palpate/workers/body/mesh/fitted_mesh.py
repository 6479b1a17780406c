"""Generation of one mesh of a body at one cell size: stuff, match the volume, improve.

The worst tetrahedra are improved by small moves of their nodes.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh
from palpate.workers.body.mesh.bcc_lattice import bcc_lattice
from palpate.workers.body.mesh.body_outline import Outline, project
from palpate.workers.body.mesh.isosurface_stuffing import stuff_isosurface
from palpate.workers.body.mesh.mesh_geometry import (
    boundary_triangles,
    compacted,
    elements_of_nodes,
    in_memory_order,
    split_boundary,
    triangle_areas_mm2,
    volumes_mm3,
    wall_nodes,
    without_nonmanifold_edges,
)
from palpate.workers.kernels_and_threads import EXACT


def improve_shape(
    mesh: TetMesh,
    skin: NDArray[np.bool_],
    on_wall: NDArray[np.bool_],
    level_mm: float,
    cell_mm: float,
    outline: Outline,
    passes: int = 4,
    good: float = 0.7,
) -> TetMesh:
    """Move nodes around tetrahedra whose M3 is below ``good`` if that improves the worst one.

    Nodes of the skin stay on the level ``level_mm`` of the outline, nodes of the wall in its
    plane.
    """
    nodes = mesh.nodes.copy()
    start, around = elements_of_nodes(mesh.tets, len(nodes))
    _improve(
        nodes,
        mesh.tets,
        start,
        around,
        skin,
        on_wall,
        level_mm,
        cell_mm,
        passes,
        good,
        outline.field,
        outline.frame,
    )
    return TetMesh(nodes, mesh.tets)


@njit(**EXACT)
def mean_ratio(nodes: FloatArray, p: int, q: int, r: int, s: int) -> float:
    """Return M3 of one tetrahedron, negative if it is inverted."""
    ax, ay, az = nodes[q, 0] - nodes[p, 0], nodes[q, 1] - nodes[p, 1], nodes[q, 2] - nodes[p, 2]
    bx, by, bz = nodes[r, 0] - nodes[p, 0], nodes[r, 1] - nodes[p, 1], nodes[r, 2] - nodes[p, 2]
    cx, cy, cz = nodes[s, 0] - nodes[p, 0], nodes[s, 1] - nodes[p, 1], nodes[s, 2] - nodes[p, 2]
    det = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    total = ax * ax + ay * ay + az * az + bx * bx + by * by + bz * bz + cx * cx + cy * cy + cz * cz
    total += (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2
    total += (bx - cx) ** 2 + (by - cy) ** 2 + (bz - cz) ** 2
    total += (cx - ax) ** 2 + (cy - ay) ** 2 + (cz - az) ** 2
    ratio = 12 * (0.5 * abs(det)) ** (2 / 3) / total
    return ratio if det > 0 else -ratio


@njit(**EXACT)
def worst_around(
    nodes: FloatArray, tets: IntArray, start: IntArray, around: IntArray, v: int
) -> float:
    """Return the lowest M3 of the tetrahedra at a node, at most 2."""
    worst = 2.0
    for a in range(start[v], start[v + 1]):
        m = around[a]
        worst = min(worst, mean_ratio(nodes, tets[m, 0], tets[m, 1], tets[m, 2], tets[m, 3]))
    return worst


@njit(**EXACT)
def _improve(
    nodes: FloatArray,
    tets: IntArray,
    start: IntArray,
    around: IntArray,
    skin: BoolArray,
    on_wall: BoolArray,
    level: float,
    cell_mm: float,
    passes: int,
    good: float,
    field: NDArray[np.float32],
    frame: FloatArray,
) -> None:
    """Try moves node by node: towards the neighbours' mean, then along the axes."""
    trial = np.empty(3)
    for sweep in range(passes):
        step = 0.12 * cell_mm * 0.6**sweep
        for v in range(len(nodes)):
            worst = worst_around(nodes, tets, start, around, v)
            if worst >= good:
                continue
            old = nodes[v].copy()
            best = old.copy()
            mean = np.zeros(3)
            for a in range(start[v], start[v + 1]):
                m = around[a]
                for c in range(4):
                    mean += nodes[tets[m, c]]
            mean = (mean / (start[v + 1] - start[v]) - old) / 3
            for move in range(9):
                if move < 3:
                    for c in range(3):
                        trial[c] = old[c] + mean[c] / 2**move
                else:
                    # Axes are tried from the best place so far.
                    trial[:] = best
                    trial[(move - 3) // 2] += step if move % 2 else -step
                if on_wall[v]:
                    trial[2] = old[2]
                if skin[v] and not project(
                    field, frame, trial, level, on_wall[v], 0.3 * cell_mm, trial
                ):
                    continue
                nodes[v] = trial
                now = worst_around(nodes, tets, start, around, v)
                if now > worst + 1e-4:
                    worst = now
                    best[:] = trial
            nodes[v] = best


@dataclass(frozen=True, eq=False)
class FittedMesh:
    """A mesh and its nodes on the chest wall (w,)."""

    mesh: TetMesh
    wall: IntArray

    @property
    def has_wall(self) -> bool:
        """Return True if a triangle of the boundary is in the wall."""
        if len(self.wall) < 3:
            return False
        return len(split_boundary(boundary_triangles(self.mesh.tets), self.wall)[1]) > 0


def fitted_mesh(outline: Outline, cell_mm: float, *, improve: bool = True) -> FittedMesh:
    """Fill an outline with tetrahedra.

    Flat triangles between nodes on a round outline cut off some volume, and so does the blur
    of the outline. The nodes are therefore moved to the level of the field at which the
    mesh has the volume of the body's voxels.

    Parameters
    ----------
    outline : Outline
    cell_mm : float
        Size of a lattice cell.
    improve : bool
        Match the volume and improve the worst tetrahedra; otherwise only the number
        of nodes is meaningful.

    Raises
    ------
    InputError
        If the body is thinner than the samples of its outline.
    """
    lattice = bcc_lattice(outline, cell_mm)
    if not len(lattice.tets):
        raise InputError(
            f"The body in the volume ({outline.volume_mm3:.3g} mm3) is too thin for tetrahedra of "
            f"{cell_mm:.3g} mm. Check the labels and spacing_mm, or give a finer volume."
        )
    stuffed = stuff_isosurface(lattice, outline)
    kept = without_nonmanifold_edges(stuffed.tets)
    mesh, _ = compacted(stuffed.nodes, kept)
    mesh, _ = in_memory_order(mesh, 0.5 * cell_mm)
    wall = wall_nodes(mesh.nodes, outline.wall_z_mm)
    if improve:
        mesh = _improved(mesh, wall, outline, cell_mm)
    return FittedMesh(mesh, wall)


def _improved(mesh: TetMesh, wall: IntArray, outline: Outline, cell_mm: float) -> TetMesh:
    """Alternate between volume matching and moving nodes, ending with the volume."""
    on_wall = np.zeros(len(mesh.nodes), np.bool_)
    on_wall[wall] = True
    surface, _ = split_boundary(boundary_triangles(mesh.tets), wall)
    skin = np.zeros(len(mesh.nodes), np.bool_)
    skin[surface] = True
    area = float(triangle_areas_mm2(mesh.nodes, surface).sum())
    level = 0.0
    for last in (False, False, True):
        level += (outline.volume_mm3 - float(volumes_mm3(mesh).sum())) / area
        level = float(np.clip(level, -0.15 * cell_mm, 0.15 * cell_mm))
        nodes = mesh.nodes.copy()
        _put_on_level(nodes, skin, on_wall, level, 0.3 * cell_mm, outline.field, outline.frame)
        mesh = TetMesh(nodes, mesh.tets)
        if not last:
            mesh = improve_shape(mesh, skin, on_wall, level, cell_mm, outline)
    return mesh


@njit(**EXACT)
def _put_on_level(
    nodes: FloatArray,
    skin: BoolArray,
    on_wall: BoolArray,
    level: float,
    reach: float,
    field: NDArray[np.float32],
    frame: FloatArray,
) -> None:
    place = np.empty(3)
    for v in range(len(nodes)):
        if skin[v] and project(field, frame, nodes[v], level, on_wall[v], reach, place):
            nodes[v] = place
