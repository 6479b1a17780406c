"""Quality of homogeneous and adaptive meshes (thesis section 4.4, Fig. 4.15 and Table 4.2).

Meshes of two tissues are compared by their tetrahedra, by plane sections, and by their agreement
with the voxels.
"""

import time
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.adaptive_lattice import Sizes
from palpate.workers.body.mesh.adaptive_mesher import adaptive_hierarchy
from palpate.workers.body.mesh.mesh_geometry import measures, summarise, volumes_mm3
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, build_hierarchy
from palpate.workers.kernels_and_threads import EXACT
from palpate.workers.thesis.phantom_compression import (
    Scale,
    check_scale,
    thesis_phantom,
    two_materials,
)

# Edges of a tetrahedron in the order of a quadrangle's corners, for tetrahedron corners (0, 1) on
# one side and (2, 3) on the other.
QUADRANGLE = ((0, 2), (0, 3), (1, 3), (1, 2))
# Nodes closer to the plane than this, relative to the mesh, are moved off it.
BESIDE = 1e-9


@dataclass(frozen=True, eq=False)
class PlaneSection:
    """Polygons in which a plane intersects the tetrahedra of a mesh.

    Parameters
    ----------
    polygons : ndarray, shape (m, 4, 2)
        Corners in mm, along the two other axes in the order of (x, y, z); a triangle repeats its
        last corner.
    tets : ndarray of int, shape (m,)
        The tetrahedron of each polygon.
    """

    polygons: FloatArray
    tets: NDArray[np.int64]


def plane_section(mesh: TetMesh, normal: int, at_mm: float) -> PlaneSection:
    """Cut a mesh with a plane normal to one axis.

    Parameters
    ----------
    mesh : TetMesh
    normal : {0, 1, 2}
        The axis normal to the plane.
    at_mm : float
        Coordinate of the plane along that axis.

    Returns
    -------
    PlaneSection
        Empty if the plane misses the mesh.
    """
    height = mesh.nodes[:, normal] - at_mm
    near = BESIDE * float(np.ptp(mesh.nodes[:, normal]))
    height = np.where(np.abs(height) < near, near, height)
    above = height[mesh.tets] > 0
    count = above.sum(axis=1)
    flat = np.delete(mesh.nodes, normal, axis=1)
    polygons, owners = [], []
    for wanted in (1, 2, 3):
        tets = np.flatnonzero(count == wanted)
        # The corners of the smaller side first; if both have two, those above.
        sides = above[tets] if wanted < 3 else ~above[tets]
        order = np.argsort(~sides, axis=1, kind="stable")
        corners = np.take_along_axis(mesh.tets[tets], order, axis=1)
        edges = QUADRANGLE if wanted == 2 else ((0, 1), (0, 2), (0, 3), (0, 3))
        polygons.append(np.stack([_crossing(corners, e, height, flat) for e in edges], axis=1))
        owners.append(tets)
    return PlaneSection(np.concatenate(polygons), np.concatenate(owners))


def _crossing(
    corners: IntArray, edge: tuple[int, int], height: FloatArray, flat: FloatArray
) -> FloatArray:
    """Return the intersection of the plane with an edge of each tetrahedron, shape (m, 2)."""
    i, j = corners[:, edge[0]], corners[:, edge[1]]
    share = (height[i] / (height[i] - height[j]))[:, None]
    return np.asarray(flat[i] + share * (flat[j] - flat[i]))


OUTSIDE, OTHER, INSIDE = 0, 1, 2
ON_A_FACE = 1e-9  # barycentric weight that still counts as inside


@dataclass(frozen=True)
class Agreement:
    """Agreement of a mesh with voxels.

    Parameters
    ----------
    labels : float
        Fraction of the body's voxels whose centre is in a tetrahedron of their own material;
        a centre outside the mesh does not agree.
    tissue_volume : float
        Volume of the tissue in the mesh over the volume of its voxels, minus one.
    body_volume : float
        The same for the whole body.
    """

    labels: float
    tissue_volume: float
    body_volume: float


def agreement(
    mesh: TetMesh, inside: BoolArray, labels: Volume, tissue: Tissue = Tissue.GLANDULAR
) -> Agreement:
    """Compare a mesh with its voxels; all tissues but one count as the same material.

    Parameters
    ----------
    mesh : TetMesh
    inside : ndarray of bool, shape (m,)
        Tetrahedra of the tissue.
    labels : Volume
    tissue : Tissue
    """
    material = np.where(labels.values == Tissue.AIR, OUTSIDE, OTHER).astype(np.uint8)
    material[labels.values == tissue] = INSIDE
    spacing = np.asarray(labels.spacing_mm, np.float64)
    meshed = _materials(
        (mesh.nodes - np.asarray(labels.origin_mm)) / spacing, mesh.tets, inside, material.shape
    )
    body = material != OUTSIDE
    volumes = volumes_mm3(mesh)
    voxels = np.bincount(material.ravel(), minlength=3) * labels.voxel_mm3
    return Agreement(
        labels=float(np.mean(meshed[body] == material[body])),
        tissue_volume=float(volumes[inside].sum() / voxels[INSIDE] - 1),
        body_volume=float(volumes.sum() / (voxels[OTHER] + voxels[INSIDE]) - 1),
    )


@njit(**EXACT)
def _materials(
    nodes: FloatArray, tets: IntArray, inside: BoolArray, shape: tuple[int, int, int]
) -> NDArray[np.uint8]:
    """Return the material of the tetrahedron at each voxel centre; nodes are in voxels."""
    materials = np.zeros(shape, np.uint8)
    nz, ny, nx = shape
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for m in range(len(tets)):
        p = nodes[tets[m, 0]]
        a, b, c = nodes[tets[m, 1]] - p, nodes[tets[m, 2]] - p, nodes[tets[m, 3]] - p
        bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
        det = a[0] * bc[0] + a[1] * bc[1] + a[2] * bc[2]
        for axis in range(3):
            least = p[axis] + min(0.0, a[axis], b[axis], c[axis])
            most = p[axis] + max(0.0, a[axis], b[axis], c[axis])
            low[axis] = max(0, int(np.ceil(least)))
            high[axis] = int(np.floor(most))
        for k in range(low[2], min(high[2], nz - 1) + 1):
            for j in range(low[1], min(high[1], ny - 1) + 1):
                for i in range(low[0], min(high[0], nx - 1) + 1):
                    x, y, z = i - p[0], j - p[1], k - p[2]
                    u = (x * bc[0] + y * bc[1] + z * bc[2]) / det
                    v = (x * ca[0] + y * ca[1] + z * ca[2]) / det
                    w = (x * ab[0] + y * ab[1] + z * ab[2]) / det
                    if min(u, v, w, 1.0 - u - v - w) >= -ON_A_FACE:
                        materials[k, j, i] = INSIDE if inside[m] else OTHER
    return materials


MeshKind = Literal["adaptive", "adaptive 1 mm", "adaptive 2 mm", "adaptive 3 mm", "homogeneous"]
KINDS: tuple[MeshKind, ...] = get_args(MeshKind)
# Size of the smallest cells of each adaptive mesh in mm. The first resolves ligaments of 0.6 mm
# between glandular compartments; edges range from half that size to 5 mm.
SMALLEST_MM: dict[MeshKind, float] = {
    "adaptive": 0.7,
    "adaptive 1 mm": 1.0,
    "adaptive 2 mm": 2.0,
    "adaptive 3 mm": 3.0,
}
# 425,000 tetrahedra in 250 ml, 12 to a cell: 0.588 mm3 each (thesis section 4.4.3).
HOMOGENEOUS_CELL_MM = float(np.cbrt(12 * 250_000 / 425_000))
MEASURES = ("M1", "M2", "M3", "M4", "aspect")
# Bins of the histograms; the measures are between 0 and 1, and aspect ratios from 10 up are bad.
BINS = 40
RANGES = {name: (1.0, 10.0) if name == "aspect" else (0.0, 1.0) for name in MEASURES}
# Factors by which the cells are enlarged.
COARSER: dict[Scale, float] = {"sketch": 2.4, "reduced": 1.0, "full": 1.0}


@dataclass(frozen=True)
class QualityRow:
    """Quality of one mesh of one phantom.

    Parameters
    ----------
    phantom : int
    kind : str
        See `KINDS`.
    tets, nodes : int
    seconds : float
        Processor time to make the mesh and its coarser levels.
    mean : dict of str to float
        Means of M1 to M4 and the aspect ratio, all 1 for a regular tetrahedron.
    m5 : float
        Ratio of the smallest to the largest volume.
    worst_aspect : float
    bad : int
        Number of tetrahedra with an aspect ratio of 10 or more.
    agreement : Agreement
        Agreement with the voxels of the phantom.
    histograms : dict of str to tuple of int
        Number of tetrahedra in `BINS` equal bins of `RANGES`; outliers are in the end bins.
    """

    phantom: int
    kind: MeshKind
    tets: int
    nodes: int
    seconds: float
    mean: dict[str, float]
    m5: float
    worst_aspect: float
    bad: int
    agreement: Agreement
    histograms: dict[str, tuple[int, ...]]


@dataclass(frozen=True)
class AspectRow:
    """Average and worst aspect ratios of one kind of mesh over all phantoms (thesis Table 4.2)."""

    kind: MeshKind
    average: float
    worst: float


def mesh_of(materials: Volume, kind: MeshKind, scale: Scale = "reduced") -> Hierarchy:
    """Mesh a phantom with two materials for the solver.

    Raises
    ------
    InputError
        If the kind is unknown.
    """
    if kind not in KINDS:
        raise InputError(f"A mesh must be one of {', '.join(KINDS)}; got {kind!r}.")
    if kind == "homogeneous":
        size = HOMOGENEOUS_CELL_MM * COARSER[scale]
        return build_hierarchy(materials, element_size_mm=size)
    smallest = SMALLEST_MM[kind] * COARSER[scale]
    skin, largest = max(2.5, smallest), max(5.0, smallest)
    return adaptive_hierarchy(materials, Sizes(smallest, skin_mm=skin, largest_mm=largest))


def kinds_at(scale: Scale) -> tuple[MeshKind, ...]:
    """Return the kinds measured at a scale; the coarsest cells are too large for a sketch."""
    large = {"sketch": ("adaptive 2 mm", "adaptive 3 mm"), "reduced": (), "full": ()}[scale]
    return tuple(k for k in KINDS if k not in large)


@dataclass(frozen=True, eq=False)
class MadeMesh:
    """A mesh of a phantom.

    Parameters
    ----------
    mesh : TetMesh
    inside : ndarray of bool, shape (tets,)
        True for glandular tetrahedra.
    materials : Volume
        The phantom, see `workers.thesis.phantom_compression.two_materials`.
    seconds : float
        Processor time to make the mesh.
    """

    mesh: TetMesh
    inside: BoolArray
    materials: Volume
    seconds: float

    def coronal_section(self) -> tuple[PlaneSection, BoolArray]:
        """Cut the mesh at the mean height of the phantom's glandular tissue (Fig. 4.14).

        Returns
        -------
        section : PlaneSection
        glandular : ndarray of bool
            True for glandular polygons.
        """
        layers = np.nonzero(self.materials.values == Tissue.GLANDULAR)[0]
        origin, spacing = self.materials.origin_mm[2], self.materials.spacing_mm[2]
        section = plane_section(self.mesh, 2, origin + float(layers.mean()) * spacing)
        return section, self.inside[section.tets]


def made_mesh(number: int, kind: MeshKind, scale: Scale = "reduced") -> MadeMesh:
    """Return a mesh of phantom `number`, 1 to 10.

    Raises
    ------
    InputError
        If the number, the kind or the scale is unknown.
    """
    check_scale(scale)
    materials = two_materials(thesis_phantom(number, scale).labels)
    started = time.process_time()
    finest = mesh_of(materials, kind, scale).finest
    inside = finest.fractions[:, Tissue.GLANDULAR] > 0.5
    return MadeMesh(finest.mesh, inside, materials, time.process_time() - started)


def row_of(number: int, kind: MeshKind, made: MadeMesh) -> QualityRow:
    """Measure the tetrahedra of a mesh of phantom `number`."""
    mesh = made.mesh
    summary, measured = summarise(mesh), measures(mesh)
    return QualityRow(
        phantom=number,
        kind=kind,
        tets=summary["tets"],
        nodes=summary["nodes"],
        seconds=made.seconds,
        mean={name: float(measured[name].mean()) for name in MEASURES},
        m5=summary["M5"],
        worst_aspect=summary["aspect"]["max"],
        bad=summary["bad"],
        agreement=agreement(mesh, made.inside, made.materials),
        histograms={name: _histogram(measured[name], RANGES[name]) for name in MEASURES},
    )


def _histogram(values: FloatArray, limits: tuple[float, float]) -> tuple[int, ...]:
    counts, _ = np.histogram(np.clip(values, *limits), BINS, limits)
    return tuple(int(n) for n in counts)


def aspect_rows(rows: tuple[QualityRow, ...]) -> tuple[AspectRow, ...]:
    """Return average and worst aspect ratios of each kind of mesh (thesis Table 4.2)."""
    found = []
    for kind in KINDS:
        of_kind = [row for row in rows if row.kind == kind]
        if of_kind:
            average = float(np.mean([row.mean["aspect"] for row in of_kind]))
            found.append(AspectRow(kind, average, max(row.worst_aspect for row in of_kind)))
    return tuple(found)
