"""Quality of homogeneous and adaptive meshes (thesis section 4.4, Fig. 4.15 and Table 4.2)."""

import time
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.adaptive_lattice import Sizes
from palpate.workers.body.mesh.adaptive_mesher import adaptive_hierarchy
from palpate.workers.body.mesh.mesh_geometry import measures, summarise
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, build_hierarchy
from palpate.workers.body.mesh.mesher_comparison import (
    Agreement,
    PlaneSection,
    agreement,
    plane_section,
)
from palpate.workers.thesis.phantom_compression import (
    Scale,
    check_scale,
    thesis_phantom,
    two_materials,
)

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
