"""Nested meshes of a label volume, coarse to fine, without loss of labelled volume.

The smallest number of nodes for a body is estimated before meshing.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.sparse import csr_matrix

from palpate.storage.errors import InputError
from palpate.storage.values import IntArray, TetMesh, Volume
from palpate.workers.body.mesh.body_outline import Outline, outline_of
from palpate.workers.body.mesh.fitted_mesh import FittedMesh, fitted_mesh
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles, split_boundary
from palpate.workers.body.mesh.nodal_interpolation import prolongation
from palpate.workers.body.mesh.tissue_fractions import majority_fractions, volume_fractions

FEWEST_CELLS = 4  # across the body's shortest side, for the finest mesh
# Ratio of the nodes of a breast's coarsest possible mesh to those of a lattice inside it: measured
# 1.6 and 1.7 on phantoms of 445 and 250 ml. Below the first value a body is refused without
# meshing; the second one is always sufficient.
CERTAIN_SHARE, ENOUGH_SHARE = 1.4, 1.85


def check_node_count(nodes: int, volume_mm3: float, smallest_extent_mm: float) -> None:
    """Raise InputError, without meshing, if a mesh of so few nodes is too coarse for a body.

    Parameters
    ----------
    nodes : int
        Target number.
    volume_mm3, smallest_extent_mm : float
        Volume of the body, and its shortest side.

    Raises
    ------
    InputError
        If elements would be too large for the body.
    """
    largest_mm = smallest_extent_mm / FEWEST_CELLS
    lattice = 2 * volume_mm3 / largest_mm**3
    if nodes < CERTAIN_SHARE * lattice:
        enough = 50 * math.ceil(ENOUGH_SHARE * lattice / 50)
        raise InputError(
            f"A mesh of {nodes} nodes is too coarse for this body: its shortest side, "
            f"{smallest_extent_mm:.3g} mm, needs {FEWEST_CELLS} elements across. Ask for "
            f"{enough} nodes or more."
        )


def check_node_count_of(nodes: int, labels: Volume) -> None:
    """Raise InputError if a mesh of so few nodes is too coarse for a labelled body.

    Raises
    ------
    InputError
        See `check_node_count`.
    """
    inside = labels.values != 0
    count = np.count_nonzero(inside)
    if not count:
        return
    flat = inside.any(axis=0)
    lines = inside.any(axis=(1, 2)), flat.any(axis=1), flat.any(axis=0)
    sides = [
        (float(np.ptp(np.flatnonzero(line))) + 1) * step
        for line, step in zip(lines, labels.spacing_mm[::-1], strict=True)
    ]
    check_node_count(nodes, count * labels.voxel_mm3, min(sides))


STEPS_PER_CELL = 3.5  # samples of the outline along one lattice cell
COARSEST_CELL = 0.43  # of the body's shortest side
RATIO = 2.3  # target ratio of cell sizes between levels
LEAST_RATIO = 1.4  # smaller ratios are not worth an extra level
COUNT_TOLERANCE = 0.06  # of the target number of nodes


@dataclass(frozen=True, eq=False)
class MeshLevel:
    """One mesh of a hierarchy.

    Parameters
    ----------
    mesh : TetMesh
    fractions : ndarray of float32, shape (m, 6)
        Fraction of each `Tissue` in each tetrahedron; rows sum to 1. One-hot on the finest level.
    wall : ndarray of int32, shape (w,)
        Nodes in the plane of the chest wall.
    surface : ndarray of int32, shape (k, 3)
        Triangles of the free surface, outward: the boundary without the wall.
    prolongation : csr_matrix, shape (n, n_coarser), or None
        Interpolates values from the next coarser level; None on the coarsest.
    """

    mesh: TetMesh
    fractions: NDArray[np.float32]
    wall: IntArray
    surface: IntArray
    prolongation: csr_matrix | None


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The meshes of one body.

    Parameters
    ----------
    levels : tuple of MeshLevel
        Coarse to fine.
    element_size_mm : float
        Size of a lattice cell of the finest level; edges are 0.87 to 1 times as long; NaN for
        meshes without a lattice.
    """

    levels: tuple[MeshLevel, ...]
    element_size_mm: float = float("nan")

    @property
    def finest(self) -> MeshLevel:
        """Return the finest mesh."""
        return self.levels[-1]


def build_hierarchy(
    labels: Volume, *, element_size_mm: float | None = None, nodes: int | None = None
) -> Hierarchy:
    """Mesh the largest body in a label volume at several sizes.

    Parameters
    ----------
    labels : Volume
        Tissue labels (`Tissue`); 0 is air. The body ends at the plane of its lowest voxel faces
        in z, the chest wall.
    element_size_mm : float, optional
        Size of a lattice cell of the finest mesh.
    nodes : int, optional
        Target number of nodes of the finest mesh, met within 10 %. Exactly one of
        ``element_size_mm`` and ``nodes`` is given.

    Raises
    ------
    InputError
        If the volume has no tissue, both or none of the sizes are given, or the elements
        are larger than a quarter of the body.
    """
    _check_request(element_size_mm, nodes)
    if element_size_mm is None:
        assert nodes is not None
        fine, outline, cell_mm = _mesh_of_nodes(labels, nodes)
    else:
        cell_mm = element_size_mm
        outline = outline_of(labels, cell_mm / STEPS_PER_CELL)
        _check_size(cell_mm, outline)
        fine = fitted_mesh(outline, cell_mm)

    fitted = [fine]
    for coarse_mm in coarser_cells(cell_mm, outline.smallest_extent_mm):
        coarse = fitted_mesh(outline, coarse_mm)
        if len(fine.wall) and not coarse.has_wall:
            break  # the body touches its wall in a spot smaller than these cells
        fitted.append(coarse)
    fitted.reverse()
    return Hierarchy(_levels(fitted, labels), float(cell_mm))


def coarser_cells(cell_mm: float, shortest_mm: float) -> list[float]:
    """Return cell sizes of the coarser levels, in equal ratios up to the coarsest that still works.

    The coarsest level (about 150 nodes) is factorised, so its size should not depend on the
    finest; the number of levels keeps the ratio near `RATIO`.
    """
    factor = shortest_mm * COARSEST_CELL / cell_mm
    count = max(round(np.log(max(factor, 1.0)) / np.log(RATIO)), 1 if factor > LEAST_RATIO else 0)
    return [cell_mm * factor ** (k / count) for k in range(1, count + 1)]


def _levels(meshes: list[FittedMesh], labels: Volume) -> tuple[MeshLevel, ...]:
    levels: list[MeshLevel] = []
    for number, fitted in enumerate(meshes):
        fractions = majority_fractions if number == len(meshes) - 1 else volume_fractions
        add_level(levels, fitted.mesh, fractions(fitted.mesh, labels), fitted.wall)
    return tuple(levels)


def add_level(
    levels: list[MeshLevel], mesh: TetMesh, fractions: NDArray[np.float32], wall: IntArray
) -> None:
    """Append a finer mesh, with the prolongation from the one before."""
    surface, _ = split_boundary(boundary_triangles(mesh.tets), wall)
    transfer = None
    if levels:
        transfer = prolongation(levels[-1].mesh, levels[-1].wall, mesh.nodes, wall)
    levels.append(MeshLevel(mesh, fractions, wall, surface, transfer))


def _mesh_of_nodes(labels: Volume, nodes: int) -> tuple[FittedMesh, Outline, float]:
    """Generate a mesh with about the target number of nodes.

    A lattice has 2 / a^3 nodes per volume and the outline adds some per area, so
    ``n(a) = 2 V / a^3 + s / a^2``; ``s`` is estimated from each trial, first from a coarser one.
    """
    outline = outline_of(labels, _rough_step(labels))
    volume = outline.volume_mm3
    largest_mm = outline.smallest_extent_mm / FEWEST_CELLS
    cell_mm = min((8 * volume / nodes) ** (1 / 3), largest_mm)
    outline = outline_of(labels, cell_mm / STEPS_PER_CELL)
    trial = fitted_mesh(outline, cell_mm, improve=False)
    for _ in range(6):
        count = len(trial.mesh.nodes)
        area_part = count * cell_mm**2 - 2 * volume / cell_mm
        cell_mm = _cell_for(nodes, volume, area_part)
        if cell_mm > largest_mm:
            fewest = 2 * volume / largest_mm**3 + area_part / largest_mm**2
            raise InputError(
                f"A mesh of {nodes} nodes is too coarse for this body: its shortest side, "
                f"{outline.smallest_extent_mm:.3g} mm, needs {FEWEST_CELLS} elements across. "
                f"Ask for {1.1 * fewest:.0f} nodes or more."
            )
        outline = outline_of(labels, cell_mm / STEPS_PER_CELL)
        trial = fitted_mesh(outline, cell_mm)
        if abs(len(trial.mesh.nodes) - nodes) <= COUNT_TOLERANCE * nodes:
            break
    return trial, outline, cell_mm


def _rough_step(labels: Volume) -> float:
    """Return a step that gives about 40 samples along the volume's longest side."""
    sides = np.asarray(labels.shape_xyz) * labels.spacing_mm
    return float(sides.max() / 40)


def _cell_for(nodes: float, volume: float, area_part: float) -> float:
    """Solve ``nodes = 2 volume / a^3 + area_part / a^2`` for a > 0 (Newton, from the left)."""
    a = (2 * volume / nodes) ** (1 / 3)
    for _ in range(50):
        value = 2 * volume / a**3 + area_part / a**2 - nodes
        slope = -6 * volume / a**4 - 2 * area_part / a**3
        a -= value / slope
    return float(a)


def _check_request(element_size_mm: float | None, nodes: int | None) -> None:
    if (element_size_mm is None) == (nodes is None):
        raise InputError(
            "Give exactly one of element_size_mm and nodes, "
            f"got element_size_mm={element_size_mm} and nodes={nodes}."
        )
    if element_size_mm is not None and not (np.isfinite(element_size_mm) and element_size_mm > 0):
        raise InputError(f"element_size_mm must be a positive number, got {element_size_mm}.")
    if nodes is not None and nodes < 1:
        raise InputError(f"nodes must be a positive number, got {nodes}; try nodes: 5000.")


def _check_size(cell_mm: float, outline: Outline) -> None:
    side = outline.smallest_extent_mm
    if cell_mm > side / FEWEST_CELLS:
        raise InputError(
            f"Elements of {cell_mm:.3g} mm are too large for a body that is {side:.3g} mm across: "
            f"at most {side / FEWEST_CELLS:.3g} mm. Give a smaller element_size_mm."
        )


LEVEL_ARRAYS = ("nodes", "tets", "fractions", "wall", "surface")
CSR_ARRAYS = ("data", "indices", "indptr")


def to_arrays(hierarchy: Hierarchy) -> dict[str, NDArray[Any]]:
    """Return plain arrays of a hierarchy, named ``<level>.<array>``, level 0 the coarsest."""
    arrays: dict[str, NDArray[Any]] = {"element_size_mm": np.array(hierarchy.element_size_mm)}
    for number, level in enumerate(hierarchy.levels):
        parts: tuple[NDArray[Any], ...] = (
            level.mesh.nodes,
            level.mesh.tets,
            level.fractions,
            level.wall,
            level.surface,
        )
        arrays |= {f"{number}.{n}": part for n, part in zip(LEVEL_ARRAYS, parts, strict=True)}
        if level.prolongation is not None:
            for name in CSR_ARRAYS:
                arrays[f"{number}.prolongation_{name}"] = getattr(level.prolongation, name)
    return arrays


def from_arrays(arrays: Mapping[str, NDArray[Any]]) -> Hierarchy:
    """Rebuild a hierarchy from the arrays of `to_arrays`."""
    levels: list[MeshLevel] = []
    while f"{len(levels)}.nodes" in arrays:
        number = len(levels)
        nodes, tets, fractions, wall, surface = (arrays[f"{number}.{n}"] for n in LEVEL_ARRAYS)
        matrix: csr_matrix | None = None
        if levels:
            parts = tuple(arrays[f"{number}.prolongation_{n}"] for n in CSR_ARRAYS)
            matrix = csr_matrix(parts, shape=(len(nodes), len(levels[-1].mesh.nodes)))
        levels.append(MeshLevel(TetMesh(nodes, tets), fractions, wall, surface, matrix))
    return Hierarchy(tuple(levels), float(arrays["element_size_mm"]))


VOLUME_TOLERANCE = 0.02  # of the volume of the labels


def mesh_whole_body(
    labels: Volume, *, element_size_mm: float | None = None, nodes: int | None = None
) -> Hierarchy:
    """Mesh a label volume with `build_hierarchy`, and compare the volumes.

    Raises
    ------
    InputError
        If it cannot be meshed, or a part of the body is lost.
    """
    try:
        hierarchy = build_hierarchy(labels, element_size_mm=element_size_mm, nodes=nodes)
    except InputError:
        # Only the largest piece was refused; the existence of others is the reason to report.
        _check_meshed_volume(_largest_piece_ml(labels), labels)
        raise
    check_mesh_volume(hierarchy.finest.mesh, labels)
    return hierarchy


def check_mesh_volume(mesh: TetMesh, labels: Volume) -> None:
    """Raise InputError if a mesh does not have the volume of its labels.

    Raises
    ------
    InputError
        If the two differ by more than `VOLUME_TOLERANCE`.
    """
    corners = mesh.nodes[mesh.tets]
    _check_meshed_volume(
        float(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum()) / 6000, labels
    )


def _check_meshed_volume(meshed_ml: float, labels: Volume) -> None:
    labelled_ml = float(np.count_nonzero(labels.values)) * labels.voxel_mm3 / 1000
    if abs(meshed_ml - labelled_ml) <= VOLUME_TOLERANCE * labelled_ml:
        return
    advice = (
        "Only the largest connected piece is meshed: connect the pieces of the body, or remove "
        "what does not belong to it. Parts thinner than an element are lost: use more nodes."
        if meshed_ml < labelled_ml
        else "Air inside the body is meshed, too: give it the label of its tissue. Bumps thinner "
        "than an element are rounded: use more nodes."
    )
    raise InputError(
        f"The mesh has a volume of {meshed_ml:.4g} ml, but its labels cover {labelled_ml:.4g} ml: "
        f"a difference of {meshed_ml / labelled_ml - 1:+.1%}, expected {VOLUME_TOLERANCE:.0%} at "
        f"most. {advice}"
    )


def _largest_piece_ml(labels: Volume) -> float:
    pieces, count = label(labels.values != 0)
    voxels = np.bincount(pieces.ravel())[1:].max() if count else 0
    return float(voxels) * labels.voxel_mm3 / 1000
