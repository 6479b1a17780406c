"""Meshes and compressions of the ten phantoms (thesis section 4.4), as tasks.

::

    measure_mesh      a phantom, a kind of mesh        > quality, agreement with the voxels
    press_phantom     these, a view and a material     > the deformed voxels
    compare_pressed   two pressed phantoms             > agreement of each compartment
"""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from palpate.storage.stores.arrays import Arrays
from palpate.storage.values import BoolArray, FloatArray, Triple, Volume
from palpate.workers.body.mesh.hierarchy import Hierarchy
from palpate.workers.mechanics.fem.problem.outcome import Outcome
from palpate.workers.tasks.task_store import TaskStore
from palpate.workers.tasks.thesis.parts import Request, Spent, Watch, cached_phantom
from palpate.workers.thesis.compression import (
    Compressed,
    CompressionRow,
    LawName,
    View,
    compared,
    compress,
)
from palpate.workers.thesis.mesh_quality import MeshKind, QualityRow, made_mesh, mesh_of, row_of
from palpate.workers.thesis.phantoms import two_materials
from palpate.workers.thesis.scale import Scale


@dataclass(frozen=True)
class Measure(Request):
    """Request to measure one mesh of one phantom."""

    MODULE: ClassVar[str] = __name__

    phantom: int
    mesh: MeshKind

    @property
    def kind(self) -> str:
        """See `Request.kind`."""
        return f"measure, {self.mesh}"


@dataclass(frozen=True)
class Press(Request):
    """Request to press one phantom on one mesh."""

    MODULE: ClassVar[str] = __name__

    phantom: int
    mesh: MeshKind
    law: LawName
    view: View

    @property
    def kind(self) -> str:
        """See `Request.kind`."""
        return f"press, {self.mesh}, {self.view}"


@dataclass(frozen=True)
class ComparePressed(Request):
    """Request to compare a phantom, already pressed, on both meshes."""

    MODULE: ClassVar[str] = __name__

    phantom: int
    law: LawName
    view: View


@dataclass(frozen=True, slots=True)
class MeasuredMesh:
    """Result of meshing a phantom; stored with glandular and other polygons of a coronal slice."""

    spent: Spent
    row: QualityRow


@dataclass(frozen=True, slots=True)
class PressedPhantom:
    """Result of a compression; stored with voxels of compartments and tissues if it converged."""

    spent: Spent
    outcome: Outcome
    seconds_per_1000: float
    tets: int
    spacing_mm: Triple | None = field(default=None)
    origins_mm: tuple[Triple, Triple] | None = field(default=None)


@dataclass(frozen=True, slots=True)
class ComparedMeshes:
    """Result of comparing both meshes of a phantom."""

    spent: Spent
    row: CompressionRow


def measure_mesh(request: Measure) -> Spent:
    """Mesh a phantom and measure the tetrahedra.

    Raises
    ------
    InputError
        If a mesher is not installed.
    """
    if not request.part.is_finished:
        watch = Watch()
        made = made_mesh(request.phantom, request.mesh, request.scale)
        row = row_of(request.phantom, request.mesh, made)
        section, glandular = made.coronal_section()
        arrays = {"polygons": section.polygons.astype(np.float32), "glandular": glandular}
        request.part.save(MeasuredMesh(watch.spent(), row), arrays)
    return request.spent


def coronal_section(request: Measure) -> tuple[FloatArray, BoolArray]:
    """Return a slice of a measured mesh: polygons (m, 4, 2), and a mask of the glandular ones."""
    _, arrays = request.part.load(MeasuredMesh)
    return np.asarray(arrays["polygons"], np.float64), np.asarray(arrays["glandular"], bool)


def press_phantom(request: Press) -> Spent:
    """Press a phantom on one mesh, and deform its voxels."""
    if not request.part.is_finished:
        watch = Watch()
        hierarchy = cached_mesh(request.store, request.phantom, request.mesh, request.scale)
        phantom = cached_phantom(request.store, request.phantom, request.scale)
        pressed = compress(phantom, hierarchy, request.view, request.law)
        arrays: Arrays = {}
        spacing, origins = None, None
        if pressed.compartments is not None and pressed.labels is not None:
            ids, labels = pressed.compartments, pressed.labels
            arrays = {"compartments": np.asarray(ids.values), "labels": np.asarray(labels.values)}
            spacing, origins = labels.spacing_mm, (ids.origin_mm, labels.origin_mm)
        tets = len(hierarchy.finest.mesh.tets)
        outcome, each = pressed.outcome, pressed.seconds_per_1000
        record = PressedPhantom(watch.spent(), outcome, each, tets, spacing, origins)
        request.part.save(record, arrays)
    return request.spent


def compare_pressed(request: ComparePressed) -> Spent:
    """Compare the glandular compartments of a phantom on its two meshes."""
    if not request.part.is_finished:
        watch = Watch()
        law, view = request.law, request.view
        adaptive, homogeneous = (
            pressed(Press(request.store, request.scale, request.phantom, mesh, law, view))
            for mesh in ("adaptive", "homogeneous")
        )
        row = compared(request.phantom, view, law, adaptive, homogeneous)
        request.part.save(ComparedMeshes(watch.spent(), row), {})
    return request.spent


def pressed(request: Press) -> Compressed:
    """Return a stored compression."""
    record, arrays = request.part.load(PressedPhantom)
    ids, labels = None, None
    if record.spacing_mm is not None and record.origins_mm is not None:
        first, second = record.origins_mm
        ids = Volume(arrays["compartments"], record.spacing_mm, first)
        labels = Volume(arrays["labels"], record.spacing_mm, second)
    return Compressed(ids, labels, record.outcome, record.seconds_per_1000)


def cached_mesh(store: str, number: int, kind: MeshKind, scale: Scale) -> Hierarchy:
    """Return the meshes of a phantom, cached in this process."""

    def make() -> Hierarchy:
        labels = cached_phantom(store, number, scale).labels
        return mesh_of(two_materials(labels), kind, scale)

    return TaskStore(store).cached(("thesis mesh", number, kind, scale), make)
