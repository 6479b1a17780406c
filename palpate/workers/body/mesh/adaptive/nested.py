"""Mesh hierarchies for the solver: an adaptive finest mesh and coarser homogeneous ones."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import IntArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.adaptive.mesher import adaptive_mesh
from palpate.workers.body.mesh.adaptive.sizing import Sizes
from palpate.workers.body.mesh.boundary import boundary_triangles, split_boundary
from palpate.workers.body.mesh.generate import fitted_mesh
from palpate.workers.body.mesh.hierarchy import STEPS_PER_CELL, Hierarchy, MeshLevel, _coarser_cells
from palpate.workers.body.mesh.outline import outline_of
from palpate.workers.body.mesh.prolongation import prolongation
from palpate.workers.body.mesh.tissue_fractions import N_TISSUES, volume_fractions


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
    for cell_mm in reversed(_coarser_cells(sizes.smallest_mm, outline.smallest_extent_mm)):
        coarse = fitted_mesh(outline, cell_mm)
        if not coarse.has_wall:
            continue  # the body touches its wall in a spot smaller than these cells
        fractions = volume_fractions(coarse.mesh, materials)
        levels.append(_level(coarse.mesh, fractions, coarse.wall, levels))
    one_hot = np.zeros((len(fine.mesh.tets), N_TISSUES), np.float32)
    one_hot[~fine.inside, Tissue.FAT] = 1
    one_hot[fine.inside, tissue] = 1
    levels.append(_level(fine.mesh, one_hot, fine.wall, levels))
    return Hierarchy(tuple(levels))


def _level(
    mesh: TetMesh, fractions: NDArray[np.float32], wall: IntArray, coarser: list[MeshLevel]
) -> MeshLevel:
    surface, _ = split_boundary(boundary_triangles(mesh.tets), wall)
    transfer = None
    if coarser:
        transfer = prolongation(coarser[-1].mesh, coarser[-1].wall, mesh.nodes, wall)
    return MeshLevel(mesh, fractions, wall, surface, transfer)
