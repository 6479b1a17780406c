"""Results of the experiments: one record for the page, the console and `--json`."""

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import fmean, stdev
from typing import Any

import numpy as np

from palpate.service.results.identification import TANGENTS
from palpate.service.results.physical_limits import DEVIATIONS
from palpate.service.results.result_records import StudyResults
from palpate.service.thesis.remaining_time import parts_of
from palpate.service.thesis.thesis_experiments import (
    Experiment,
    SearchRun,
    ThesisRequest,
    comparisons,
    compressions,
    exposures,
    finished_search,
    measured_meshes,
    variations,
)
from palpate.workers.tasks.thesis_tasks import (
    Compare,
    ComparedBars,
    ComparedMeshes,
    ExposedPhantom,
    MeasuredMesh,
    Press,
    PressedPhantom,
    Turn,
    TurnedCylinder,
    VariedConstant,
    machine,
)
from palpate.workers.thesis.coefficient_choice import BarExperiment, CylinderRow, Selection, select
from palpate.workers.thesis.mesh_quality import AspectRow, MeshKind, QualityRow, aspect_rows
from palpate.workers.thesis.phantom_compression import (
    TARGETS,
    CompressionRow,
    LawName,
    Scale,
    TargetName,
    View,
)
from palpate.workers.thesis.thesis_eyes import OgdenConstants


@dataclass(frozen=True)
class Cost:
    """Processor seconds of an experiment and of its longest part, and the machine."""

    cpu_s: float
    longest_s: float
    parts: int
    machine: str


@dataclass(frozen=True)
class CoefficientsResult:
    """Results for the bar and the cylinder."""

    bar: BarExperiment
    selection: Selection
    cylinder: tuple[CylinderRow, ...]


@dataclass(frozen=True)
class MeanCompression:
    """Means over the phantoms for one view and law (Table 4.3), and their number."""

    view: View
    law: LawName
    phantoms: int
    diverged: int
    centroid_mm: float
    volume_mm3: float
    jc: float
    mhd_mm: float
    whole_jc: float
    whole_mhd_mm: float


@dataclass(frozen=True)
class SolverTime:
    """Processor seconds of the solver per 1000 tetrahedra: mean and deviation (Fig. 4.16)."""

    mesh: MeshKind
    view: View
    mean_s: float
    sd_s: float
    tets: int
    whole_s: float


@dataclass(frozen=True)
class MeshResult:
    """Quality and compressions of the meshes."""

    quality: tuple[QualityRow, ...]
    aspects: tuple[AspectRow, ...]
    compressions: tuple[CompressionRow, ...]
    means: tuple[MeanCompression, ...]
    times: tuple[SolverTime, ...]


@dataclass(frozen=True)
class Exposed:
    """A pair of mammograms; its pictures are in the store."""

    phantom: int
    view: View
    attenuation_rms: float
    quantum_rms: float


@dataclass(frozen=True)
class FoundConstant:
    """One constant of one search.

    Parameters
    ----------
    name, unit : str
    target, estimate : float
        In external units.
    error : float
        Relative error.
    genetic_error : float or None
        Relative error before the refinement; None without one.
    interval : tuple of float or None
        90 % interval.
    bound : float or None
        Relative standard deviation allowed by the derivatives (Cramér-Rao).
    """

    name: str
    unit: str
    target: float
    estimate: float
    error: float
    genetic_error: float | None
    interval: tuple[float, float] | None
    bound: float | None


@dataclass(frozen=True)
class FoundSearch:
    """A completed search; of a cornea it has no phantom and no voxels."""

    target: TargetName
    phantom: int | None
    constants: tuple[FoundConstant, ...]
    jc: float | None
    mhd_mm: float | None
    mhd_voxels: float | None
    evaluations: int
    reused: int
    cpu_s: float
    wall_s: float
    stopped: str
    folder: str


@dataclass(frozen=True)
class SearchResult:
    """All completed searches."""

    strategy: str
    population: int
    generations: int
    nodes: int
    spacing_mm: float
    searches: tuple[FoundSearch, ...]

    def of(self, target: TargetName) -> list[FoundSearch]:
        """Return the searches for one target."""
        return [s for s in self.searches if s.target == target]


@dataclass(frozen=True)
class Varied:
    """Scores against one constant, including its target value."""

    target: TargetName
    constant: str
    at_target: float
    values_kpa: tuple[float, ...]
    jc: tuple[float | None, ...]
    mhd_mm: tuple[float | None, ...]
    mhd_voxels: tuple[float | None, ...]

    @property
    def lowest_jc(self) -> float:
        """Return the smallest overlap over the interval; nan if nothing converged."""
        return min((v for v in self.jc if v is not None), default=np.nan)

    @property
    def most_mhd_voxels(self) -> float:
        """Return the largest distance over the interval."""
        return max((v for v in self.mhd_voxels if v is not None), default=np.nan)


@dataclass(frozen=True)
class ThesisResults:
    """Stored results of the requested experiments; None if an experiment is incomplete.

    Parameters
    ----------
    scale : str
    machine : str
        The machine that writes the results.
    costs : mapping of str to Cost
        By experiment, for the parts in the store.
    """

    scale: Scale
    machine: str
    costs: Mapping[str, Cost]
    coefficients: CoefficientsResult | None = None
    meshes: MeshResult | None = None
    mammograms: tuple[Exposed, ...] | None = None
    search: SearchResult | None = None
    sensitivity: tuple[Varied, ...] | None = None
    cornea: tuple[FoundSearch, ...] | None = None


def shear_modulus_error(found: FoundSearch) -> float:
    """Return the relative error of a cornea's shear modulus at rest, 1/2 sum mu alpha."""
    estimate, target = (
        OgdenConstants(*values).shear_modulus_mpa
        for values in zip(*((c.estimate, c.target) for c in found.constants), strict=True)
    )
    return estimate / target - 1


def thesis_results(request: ThesisRequest) -> ThesisResults:
    """Read the results from the store and the studies."""
    store, scale = str(request.store), request.scale
    whole = {e for e in request.experiments if _is_whole(e, request)}
    return ThesisResults(
        scale=scale,
        machine=machine(),
        costs={e: cost for e in request.experiments if (cost := _cost(e, request)) is not None},
        coefficients=_coefficients(store, scale) if "coefficients" in whole else None,
        meshes=_meshes(store, scale) if "mesh-quality" in whole else None,
        mammograms=_mammograms(store, scale) if "mammogram" in whole else None,
        search=_search(request) if "search" in whole else None,
        sensitivity=_sensitivity(store, scale) if "sensitivity" in whole else None,
        cornea=_finished(request.searches_of("cornea")) if "cornea" in whole else None,
    )


def _is_whole(experiment: Experiment, request: ThesisRequest) -> bool:
    if experiment in ("search", "cornea"):
        return any(run.is_finished for run in request.searches_of(experiment))
    parts = parts_of(experiment, str(request.store), request.scale)
    return all(part.part.is_finished for part in parts)


def _cost(experiment: Experiment, request: ThesisRequest) -> Cost | None:
    parts = [
        p.spent
        for p in parts_of(experiment, str(request.store), request.scale)
        if p.part.is_finished
    ]
    seconds = [p.cpu_s for p in parts]
    machines = {p.machine for p in parts}
    for _, results in finished_search(request.searches_of(experiment)):
        seconds.append(sum(time.total_s for time in results.stages.values()))
        machines.add(machine())
    if not seconds:
        return None
    return Cost(sum(seconds), max(seconds), len(seconds), "; ".join(sorted(machines)))


def _coefficients(store: str, scale: Scale) -> CoefficientsResult:
    bar = Compare(store, scale).part.record(ComparedBars).experiment
    rows = Turn(store, scale).part.record(TurnedCylinder).rows
    return CoefficientsResult(bar, select(bar), rows)


def _meshes(store: str, scale: Scale) -> MeshResult:
    quality = tuple(r.part.record(MeasuredMesh).row for r in measured_meshes(store, scale))
    rows = tuple(r.part.record(ComparedMeshes).row for r in comparisons(store, scale))
    pressed = [(r, r.part.record(PressedPhantom)) for r in compressions(store, scale)]
    return MeshResult(quality, aspect_rows(quality), rows, _means(rows), _times(pressed))


def _means(rows: tuple[CompressionRow, ...]) -> tuple[MeanCompression, ...]:
    averages = []
    for law, view in dict.fromkeys((row.law, row.view) for row in rows):
        of_both = [row for row in rows if (row.law, row.view) == (law, view)]
        good = [row for row in of_both if np.isfinite(row.jc)]
        if not good:
            continue
        names = ("centroid_mm", "volume_mm3", "jc", "mhd_mm", "whole_jc", "whole_mhd_mm")
        means = [fmean(getattr(row, name) for row in good) for name in names]
        averages.append(MeanCompression(view, law, len(good), len(of_both) - len(good), *means))
    return tuple(averages)


def _times(pressed: list[tuple[Press, PressedPhantom]]) -> tuple[SolverTime, ...]:
    times = []
    for mesh, view in dict.fromkeys((r.mesh, r.view) for r, _ in pressed):
        good = [
            record
            for request, record in pressed
            if (request.mesh, request.view) == (mesh, view)
            and request.law == "neo-Hookean"
            and record.outcome.converged
        ]
        if good:
            each = [record.seconds_per_1000 for record in good]
            tets = round(fmean(record.tets for record in good))
            whole = fmean(record.seconds_per_1000 * record.tets / 1000 for record in good)
            sd = stdev(each) if len(each) > 1 else 0.0
            times.append(SolverTime(mesh, view, fmean(each), sd, tets, whole))
    return tuple(times)


def _mammograms(store: str, scale: Scale) -> tuple[Exposed, ...]:
    found = []
    for request in exposures(store, scale):
        record = request.part.record(ExposedPhantom)
        if record.converged:
            rms = record.attenuation_rms, record.quantum_rms
            found.append(Exposed(request.phantom, request.view, *rms))
    return tuple(found)


def _search(request: ThesisRequest) -> SearchResult:
    runs = request.searches_of("search")
    spec = runs[0].spec
    case: Any = spec.case.model_dump()
    return SearchResult(
        strategy=request.strategy,
        population=spec.search.population,
        generations=spec.search.generations,
        nodes=case["mesh"]["nodes"],
        spacing_mm=case["reference"]["phantom"]["spacing_mm"],
        searches=_finished(runs),
    )


def _finished(runs: list[SearchRun]) -> tuple[FoundSearch, ...]:
    return tuple(_found(run.target, run.phantom, results) for run, results in finished_search(runs))


def _found(target: TargetName, phantom: int | None, results: StudyResults) -> FoundSearch:
    score: Mapping[str, Any] = results.best_score or {}
    counts = results.counts
    ended = counts.done + counts.diverged + counts.crashed + counts.lost
    return FoundSearch(
        target=target,
        phantom=phantom,
        constants=tuple(_constant(name, results) for name in results.estimates),
        jc=score.get("jc"),
        mhd_mm=score.get("mhd_mm"),
        mhd_voxels=score.get("mhd_voxels"),
        evaluations=ended,
        reused=counts.reused,
        cpu_s=sum(time.total_s for time in results.stages.values()),
        wall_s=results.wall_s,
        stopped=results.stop_reason or "",
        folder=str(results.folder),
    )


def _constant(name: str, results: StudyResults) -> FoundConstant:
    constant = results.estimates[name]
    before = constant.before_polish
    target = constant.target or 0.0
    interval, bound = None, None
    if results.identification is not None:
        known = results.identification.constants.get(name)
        if known is not None and known.interval is not None:
            interval = (known.interval.lower, known.interval.upper)
            if known.interval.origin == TANGENTS:
                bound = (interval[1] - interval[0]) / (2 * DEVIATIONS * target)
    return FoundConstant(
        name,
        constant.unit,
        target,
        np.nan if constant.estimate is None else constant.estimate,
        np.nan if constant.relative_error is None else constant.relative_error,
        None if before is None else abs(before / target - 1),
        interval,
        bound,
    )


def _sensitivity(store: str, scale: Scale) -> tuple[Varied, ...]:
    varied = []
    requests = variations(store, scale)
    for target, constant in dict.fromkeys((r.target, r.constant) for r in requests):
        of_both = [r for r in requests if (r.target, r.constant) == (target, constant)]
        records = [r.part.record(VariedConstant) for r in of_both]
        varied.append(
            Varied(
                target,
                constant,
                TARGETS[target][constant],
                tuple(r.value_kpa for r in of_both),
                tuple(r.jc for r in records),
                tuple(r.mhd_mm for r in records),
                tuple(r.mhd_voxels for r in records),
            )
        )
    return tuple(varied)
