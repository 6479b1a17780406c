"""Dask tasks of a plan: a small request in, a small record out.

::

    list_loads      a case or a study    > the planned loads, and those that could be added
    analyse_load    one of them          > the sensitivity of its scan to constants and effects
    weigh_plan      all of them          > the detectable effects, and loads that would add more

Every task is idempotent: stored results are not computed again. A request names digests, so
workers need only the store.
"""

import time
from dataclasses import dataclass, replace

from palpate.storage.errors import InputError
from palpate.storage.json_digests import digest
from palpate.workers.diagnosis.expected_information import LoadSensitivity, load_sensitivity
from palpate.workers.diagnosis.plan_summary import PlanSummary
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.planned_acquisition import Acquisition, inverse_problem_of
from palpate.workers.diagnosis.scan_plan import CandidateLoad, candidate_loads, make_plan
from palpate.workers.kernels_and_threads import scan_threads
from palpate.workers.organs.source_registry import source_module
from palpate.workers.tasks.code_version import code_version
from palpate.workers.tasks.diagnosis_sources import SourceName, stored_planned
from palpate.workers.tasks.diagnosis_store import plugged_modules
from palpate.workers.tasks.task_store import Part, TaskStore

NOMINAL = "nominal"


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Request for a plan: everything a task needs to find the rest in the store.

    Parameters
    ----------
    store : str
        Folder visible to all workers.
    source : SourceName
        The source to plan for; see `workers.tasks.diagnosis_sources.add_source`.
    nodes : int
        Number of nodes of the mesh.
    spacing_mm : float
        Distance between points on the interfaces.
    name : str
        Digest of all of these and of the code; see `named_plan`.
    """

    store: str
    source: SourceName
    nodes: int
    spacing_mm: float
    name: str = ""


@dataclass(frozen=True, slots=True)
class LoadsRecord:
    """Names of the loads, the planned ones first, and the number of points."""

    loads: tuple[str, ...]
    points: int


@dataclass(frozen=True, slots=True)
class LoadRecord:
    """Result for one load: whether the nominal model converges, and the travel of the plates."""

    name: str
    simulated: bool
    travel_mm: float | None
    seconds: float


def named_plan(request: PlanRequest) -> PlanRequest:
    """Return the request, named after a digest of everything its result depends on."""
    how = [request.nodes, request.spacing_mm, _code(request.source.kind)]
    return replace(request, name=digest("plan", request.source.digest, *how))


def _code(kind: str) -> str:
    return code_version("palpate.workers.tasks.plan_tasks", source_module(kind), *plugged_modules())


def list_loads(request: PlanRequest) -> LoadsRecord:
    """List the planned loads, then those that could be added."""
    unloaded, loads = _body(request)
    return LoadsRecord(tuple(load.name for load in loads), len(unloaded.points))


def analyse_load(request: PlanRequest, number: int) -> LoadRecord:
    """Simulate one load, and the change in its scan due to each effect."""
    part = _part(request, "load", number)
    if not part.is_finished:
        begun = time.perf_counter()
        unloaded, loads = _body(request)
        load = loads[number]
        sensitivity = load_sensitivity(
            unloaded, load.name, load.problem, _acquisition(request).effects
        )
        travel_mm = None if sensitivity is None else sensitivity.travel_mm
        arrays = (
            {} if sensitivity is None else {NOMINAL: sensitivity.nominal, **sensitivity.columns}
        )
        spent = time.perf_counter() - begun
        part.save(LoadRecord(load.name, sensitivity is not None, travel_mm, spent), arrays)
    return part.record(LoadRecord)


def weigh_plan(request: PlanRequest, threads: int = 1) -> PlanSummary:
    """Determine which effects the acquisition can detect, and which loads would add more.

    Parameters
    ----------
    request : PlanRequest
    threads : int
        Number of threads that would otherwise be idle.

    Raises
    ------
    InputError
        If a planned load cannot be simulated.
    """
    part = _part(request, "summary")
    if not part.is_finished:
        unloaded, loads = _body(request)
        known = {
            number: sensitivity
            for number in range(len(loads))
            if (sensitivity := _stored(request, number)) is not None
        }
        lost = [
            load.name for n, load in enumerate(loads) if load.kind == "planned" and n not in known
        ]
        if lost:
            raise InputError(
                f"The nominal model does not converge at {', '.join(lost)} in the middle of the "
                "plausible intervals. Check the loads, units and constants."
            )
        acquisition = _acquisition(request)
        with scan_threads(threads) as each:
            plan = make_plan(acquisition.name, unloaded, loads, known, acquisition.effects, each)
        part.save(plan, {})
    return part.record(PlanSummary)


def stored_plan(request: PlanRequest) -> PlanSummary | None:
    """Return the plan, or None if it is not stored."""
    part = _part(request, "summary")
    return part.record(PlanSummary) if part.is_finished else None


def _stored(request: PlanRequest, number: int) -> LoadSensitivity | None:
    record, arrays = _part(request, "load", number).load(LoadRecord)
    if record.travel_mm is None:
        return None
    columns = {name: values for name, values in arrays.items() if name != NOMINAL}
    return LoadSensitivity(arrays[NOMINAL], columns, record.travel_mm)


def _body(request: PlanRequest) -> tuple[InverseProblem, list[CandidateLoad]]:
    """Return the body at rest and all loads, cached in each process."""

    def make() -> tuple[InverseProblem, list[CandidateLoad]]:
        acquisition = _acquisition(request)
        unloaded = inverse_problem_of(acquisition, request.nodes, request.spacing_mm)
        nodes_mm = unloaded.model.finest.nodes
        return unloaded, candidate_loads(acquisition, unloaded.frame, nodes_mm)

    return TaskStore(request.store).cached(("plan", request.name), make)


def _acquisition(request: PlanRequest) -> Acquisition:
    return stored_planned(request.source, TaskStore(request.store)).acquisition


def _part(request: PlanRequest, *which: str | int) -> Part:
    return Part(TaskStore(request.store), digest("plan", request.name, *which))
