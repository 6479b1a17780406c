"""The experiments of the thesis as tasks: a small request in, a small record out.

::

    bend_bar          one of nine loads               > the displacement
    compare_bars      all of them                     > 28 coefficients of eight wrong deformations
    turn_cylinder     nothing                         > JC, DC, MHD and GSF against the angle
    measure_mesh      a phantom, a kind of mesh       > quality, agreement with the voxels
    press_phantom     these, a view and a material    > the deformed voxels
    compare_pressed   two pressed phantoms            > agreement of each compartment
    take_mammograms   a phantom on both meshes        > mammograms and their difference
    vary_constant     one constant, others at target  > agreement with the target

The bar and the cylinder are of thesis section 3.3, the meshes, compressions and mammograms of the
ten phantoms of section 4.4 (mammograms: Fig. 4.18), the varied constants of Fig. 4.22.

Every task stores its part, with the time it took, under the digest of the request and of the code
that it imports, so an interrupted experiment continues where it stopped.
"""

import os
import platform
import time
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from palpate.storage.json_digests import digest
from palpate.storage.stored_arrays import Arrays
from palpate.storage.values import BoolArray, FloatArray, Triple, Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy
from palpate.workers.body.phantom.phantom_generation import Phantom
from palpate.workers.comparison.mammogram_image import dicom_bytes, mammogram_dataset
from palpate.workers.mechanics.fem.boundary_value_problem import Outcome
from palpate.workers.tasks.code_version import code_version
from palpate.workers.tasks.study_tasks import case_of as read_case
from palpate.workers.tasks.study_tasks import evaluate, make_target, prepare_case
from palpate.workers.tasks.task_store import Part, TaskStore
from palpate.workers.thesis.coefficient_choice import (
    DEFORMATIONS,
    Bar,
    BarExperiment,
    CylinderRow,
    bend,
    compared_bars,
    cylinder_experiment,
    force_of,
    make_bar,
)
from palpate.workers.thesis.mesh_quality import MeshKind, QualityRow, made_mesh, mesh_of, row_of
from palpate.workers.thesis.phantom_compression import (
    PIXEL_MM,
    TARGETS,
    Compressed,
    CompressionRow,
    LawName,
    Scale,
    TargetName,
    View,
    case_of,
    compared,
    compress,
    mammogram_pair,
    thesis_phantom,
    two_materials,
)


@dataclass(frozen=True, slots=True)
class Spent:
    """Cost of a part.

    Parameters
    ----------
    wall_s, cpu_s : float
        Wall-clock seconds, and processor seconds of this process, which are fewer on a busy
        machine.
    machine : str
        Machine that computed the part.
    """

    wall_s: float
    cpu_s: float
    machine: str


@dataclass(frozen=True, slots=True)
class Timed:
    """The first field of every record, sufficient for progress reports and estimates."""

    spent: Spent


@dataclass(frozen=True)
class Request:
    """One part of an experiment, named by the fields of its class other than `store`.

    Parameters
    ----------
    store : str
        Folder visible to all workers.
    scale : str
        One of `workers.thesis.phantom_compression.SCALES`.
    """

    MODULE: ClassVar[str]

    store: str
    scale: Scale

    @property
    def part(self) -> Part:
        """Part that holds the result."""
        which = [type(self).__name__, *astuple(self)[1:]]
        return Part(TaskStore(self.store), digest("thesis", which, code_version(self.MODULE)))

    @property
    def kind(self) -> str:
        """Group of requests that take about equally long, such as `press, adaptive, CC`."""
        return type(self).__name__.lower()

    @property
    def label(self) -> str:
        """Description for users."""
        return ", ".join(str(v) for v in (type(self).__name__.lower(), *astuple(self)[2:]))

    @property
    def spent(self) -> Spent:
        """Cost of the part, once finished."""
        return self.part.record(Timed).spent


class Watch:
    """Stopwatch that starts when created.

    Examples
    --------
    >>> Watch().spent().wall_s < 1
    True
    """

    def __init__(self) -> None:
        self._wall_s, self._cpu_s = time.perf_counter(), time.process_time()

    def spent(self) -> Spent:
        """Return the time spent so far."""
        wall_s, cpu_s = time.perf_counter() - self._wall_s, time.process_time() - self._cpu_s
        return Spent(wall_s, cpu_s, machine())


def machine() -> str:
    """Return the name of the processor, if known, and the number of its cores."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    name = models[0] if models else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores"


def cached_phantom(store: str, number: int, scale: Scale) -> Phantom:
    """Return a phantom of the thesis, cached in this process."""
    make = lambda: thesis_phantom(number, scale)  # noqa: E731
    return TaskStore(store).cached(("phantom", number, scale), make)


@dataclass(frozen=True)
class Bend(Request):
    """Request to bend the bar; number 0 is the gold standard."""

    MODULE: ClassVar[str] = __name__

    number: int


@dataclass(frozen=True)
class Compare(Request):
    """Request to compare all bars, already bent, with the gold standard."""

    MODULE: ClassVar[str] = __name__


@dataclass(frozen=True)
class Turn(Request):
    """Request to rotate the cylinder."""

    MODULE: ClassVar[str] = __name__


@dataclass(frozen=True, slots=True)
class BentBar:
    """Result of bending a bar; stored with the displacement, in mm."""

    spent: Spent
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class ComparedBars:
    """Results of the bar experiment."""

    spent: Spent
    experiment: BarExperiment


@dataclass(frozen=True, slots=True)
class TurnedCylinder:
    """Results of the cylinder experiment."""

    spent: Spent
    rows: tuple[CylinderRow, ...]


def bend_bar(request: Bend) -> Spent:
    """Simulate one deformation of the bar."""
    if not request.part.is_finished:
        watch = Watch()
        displacement, outcome = bend(_bar(request), force_of(request.number))
        request.part.save(BentBar(watch.spent(), outcome), {"displacement_mm": displacement})
    return request.spent


def compare_bars(request: Compare) -> Spent:
    """Compare the wrong deformations with the gold standard.

    Raises
    ------
    InputError
        If the gold standard did not converge.
    """
    if not request.part.is_finished:
        watch = Watch()
        bent = {n: _bent(request, n) for n in (0, *DEFORMATIONS)}
        experiment = compared_bars(request.scale, _bar(request), bent)
        request.part.save(ComparedBars(watch.spent(), experiment), {})
    return request.spent


def turn_cylinder(request: Turn) -> Spent:
    """Compare the cylinder with itself, rotated by each of the thesis' angles."""
    if not request.part.is_finished:
        watch = Watch()
        rows = cylinder_experiment(request.scale)
        request.part.save(TurnedCylinder(watch.spent(), rows), {})
    return request.spent


def _bar(request: Request) -> Bar:
    make = lambda: make_bar(request.scale)  # noqa: E731
    return TaskStore(request.store).cached(("bar", request.scale), make)


def _bent(request: Request, number: int) -> tuple[FloatArray, Outcome]:
    record, arrays = Bend(request.store, request.scale, number).part.load(BentBar)
    return arrays["displacement_mm"], record.outcome


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


@dataclass(frozen=True)
class Expose(Request):
    """Request for mammograms of a phantom, already pressed, on both meshes."""

    MODULE: ClassVar[str] = __name__

    phantom: int
    view: View


@dataclass(frozen=True, slots=True)
class ExposedPhantom:
    """Result of taking two mammograms; stored with pictures and DICOM files as bytes.

    Parameters
    ----------
    spent : Spent
    converged : bool
        Whether both compressions converged; if not, there are no pictures.
    attenuation_rms, quantum_rms : float
        See `workers.thesis.phantom_compression.MammogramPair`; nan without pictures.
    """

    spent: Spent
    converged: bool
    attenuation_rms: float
    quantum_rms: float


def take_mammograms(request: Expose) -> Spent:
    """Take mammograms of one phantom on both meshes, and store them with their difference."""
    if not request.part.is_finished:
        watch = Watch()
        adaptive, homogeneous = (
            pressed(
                Press(request.store, request.scale, request.phantom, mesh, "neo-Hookean",
                      request.view)
            )
            for mesh in ("adaptive", "homogeneous")
        )  # fmt: skip
        if adaptive.labels is None or homogeneous.labels is None:
            request.part.save(ExposedPhantom(watch.spent(), False, np.nan, np.nan), {})
            return request.spent
        pixel_mm = PIXEL_MM[request.scale]
        pair = mammogram_pair(adaptive, homogeneous, request.view, pixel_mm, seed=request.phantom)
        name = f"PHANTOM^{request.phantom}"
        files = {
            mesh: dicom_bytes(mammogram_dataset(taken, request.view, body_name=name))
            for mesh, taken in (("adaptive", pair.adaptive), ("homogeneous", pair.homogeneous))
        }
        arrays = {
            "adaptive": pair.adaptive_picture,
            "homogeneous": pair.homogeneous_picture,
            "difference": pair.difference,
        }
        for mesh, content in files.items():
            arrays[f"{mesh}_dicom"] = np.frombuffer(content, np.uint8)
        rms = pair.attenuation_rms, pair.quantum_rms
        request.part.save(ExposedPhantom(watch.spent(), True, *rms), arrays)
    return request.spent


@dataclass(frozen=True)
class Vary(Request):
    """Request to compare the target with the body deformed after changing one constant."""

    MODULE: ClassVar[str] = __name__

    target: TargetName
    phantom: int
    constant: str
    value_kpa: float

    @property
    def kind(self) -> str:
        """See `Request.kind`."""
        return f"vary, {self.target}"


@dataclass(frozen=True, slots=True)
class VariedConstant:
    """Scores of the body with one constant changed; None if it diverged."""

    spent: Spent
    jc: float | None
    mhd_mm: float | None
    mhd_voxels: float | None


def vary_constant(request: Vary) -> Spent:
    """Simulate the target and the same body with one constant changed, and compare them."""
    if not request.part.is_finished:
        watch = Watch()
        case = case_of(request.target, request.phantom, request.scale)
        prepared = prepare_case(case, request.store)
        target = make_target(case, {"constants": TARGETS[request.target]}, request.store)
        door = TARGETS[request.target] | {request.constant: request.value_kpa}
        result = evaluate(
            {
                "store": request.store,
                "case": case,
                "prepared": prepared,
                "target": target["target"],
                "constants": read_case(case).parameters.from_door(door),
            }
        )
        score = result.get("score") or {}
        scores = (score.get("jc"), score.get("mhd_mm"), score.get("mhd_voxels"))
        request.part.save(VariedConstant(watch.spent(), *scores), {})
    return request.spent
