"""Generation of one mesh of a body at one cell size: stuff, match the volume, improve."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh
from palpate.workers.body.mesh.bcc_lattice import bcc_lattice
from palpate.workers.body.mesh.boundary import (
    boundary_triangles,
    split_boundary,
    triangle_areas_mm2,
    wall_nodes,
    without_nonmanifold_edges,
)
from palpate.workers.body.mesh.isosurface_stuffing import stuff_isosurface
from palpate.workers.body.mesh.node_order import in_memory_order
from palpate.workers.body.mesh.node_smoothing import improve_shape
from palpate.workers.body.mesh.outline import Outline, project
from palpate.workers.body.mesh.quality import volumes_mm3
from palpate.workers.compile_flags import EXACT


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
    used = np.zeros(len(stuffed.nodes), np.bool_)
    used[kept] = True
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    mesh = TetMesh(stuffed.nodes[used], number[kept])
    mesh = in_memory_order(mesh, 0.5 * cell_mm)
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
