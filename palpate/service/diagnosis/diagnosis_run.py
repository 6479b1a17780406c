"""Diagnoses and plans from their source to their outcome: tasks are sent until none is needed.

Every step is a task that stores its result under the digest of everything it depends on.
Running a diagnosis and continuing an interrupted one are the same. A plan simulates every load and
evaluates the results. `Step` is the progress of either; `run_and_tell` also reports it to the
scheduler, for the tab of `service.cluster.dask_dashboard`.
"""

import math
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from distributed import Client

from palpate.service.cluster.task_dispatch import Dispatcher, Ending, Task, TaskCalls, value_of
from palpate.service.errors_and_interrupts import TaskError
from palpate.service.study.preflight import require_plugins
from palpate.service.study.study_session import SchedulerEvents
from palpate.storage.backends.store_paths import Location
from palpate.storage.read_only import ReadOnly
from palpate.storage.stored_arrays import Arrays
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.outcome.diagnosis_source import Source
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.diagnosis.plan_summary import PlanSummary
from palpate.workers.organs.plausibility_rule import Finding
from palpate.workers.plugins import Plugin, foreign_plugins
from palpate.workers.tasks.diagnosis_sources import (
    add_source,
    check_nodes,
    check_source,
    open_planned,
    open_source,
)
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest, DiagnosisStore, Outcome, named
from palpate.workers.tasks.diagnosis_tasks import (
    analyse_effect,
    calibrate_nominal,
    fit_effects,
    fit_topic,
    prepare_scan,
    weigh_hypotheses,
)
from palpate.workers.tasks.plan_tasks import (
    PlanRequest,
    analyse_load,
    list_loads,
    named_plan,
    weigh_plan,
)
from palpate.workers.tasks.task_store import TaskStore


@dataclass(frozen=True)
class Step:
    """The progress of a diagnosis or of a plan.

    Parameters
    ----------
    phase : {"preparation", "calibration", "effects", "weighing", "refits", "loads"}
        A plan has "loads" and "weighing".
    done, of : int
        Completed tasks of the phase, and all of them; 0 when it begins.
    task : str
        Subject of the last task: "plate_tilt with friction". Empty when the phase begins.
    record : object
        Its result.
    """

    phase: str
    done: int
    of: int
    task: str = ""
    record: object = None


Observer = Callable[[Step], object]
"""Called at the beginning of a phase and after each of its tasks."""


R = TypeVar("R")


class Workers(Protocol):
    """The workers: a `service.cluster.task_dispatch.Dispatcher`, or this process."""

    @property
    def threads(self) -> int:
        """Tasks that can run at once."""

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Run a task for each key and its arguments."""

    def everywhere(self, task: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Run a task on each current worker."""


@dataclass(frozen=True, eq=False)
class FinishedDiagnosis(ReadOnly):
    """A completed diagnosis.

    Parameters
    ----------
    summary : Summary
    maps : mapping of str to ndarray
        ``points`` (k, 3) in mm; ``interface`` (k,), 0 for the outline; ``before``,
        ``noise`` (standard deviation) and, if an effect is named, ``after``: residuals
        in mm, shape (scans, k). Read-only.
    scans : sequence of str
        Names of the loaded scans.
    """

    summary: Summary
    maps: Arrays
    scans: tuple[str, ...]


def request_for(
    source: Path | Source,
    store: Location,
    nodes: int = SETTINGS.mesh.nodes,
    spacing_mm: float | None = None,
    effects: Iterable[str] | None = None,
) -> DiagnosisRequest:
    """Read the source into the store, and return the request for the workers.

    Parameters
    ----------
    source : Path or Source
        The source or its path; see `workers.tasks.diagnosis_sources.open_source`.
    store : str or Path
        Created if missing.
    nodes : int
        Number of nodes of the mesh.
    spacing_mm : float, optional
        Spacing of points on the interfaces; larger if there are more than two loaded scans.
    effects : iterable of str, optional
        The suspected effects. Default: the whole catalogue of the source.

    Raises
    ------
    InputError
        If the path cannot be diagnosed.
    StoreError
        If the store cannot be used.
    """
    if isinstance(source, Path):
        source = open_source(source.expanduser().absolute(), store)
    check_nodes(nodes, source)
    if spacing_mm is None:
        points = SETTINGS.points
        sparser = math.sqrt(max(1.0, len(source.scans) / points.scans_at_that_spacing))
        spacing_mm = points.spacing_mm * sparser
    known = [e.name for e in source.effects]
    suspected = tuple(known if effects is None else effects)
    parts = TaskStore(store)
    return named(
        DiagnosisRequest(
            str(parts.store.root), add_source(source, parts), nodes, spacing_mm, suspected
        )
    )


def with_caveats(diagnosis: FinishedDiagnosis, caveats: tuple[str, ...]) -> FinishedDiagnosis:
    """Return a diagnosis with these caveats added first."""
    summary = replace(diagnosis.summary, caveats=caveats or None)
    return replace(diagnosis, summary=summary)


def finished(request: DiagnosisRequest) -> FinishedDiagnosis | None:
    """Return the diagnosis from the store, or None."""
    part = DiagnosisStore(request).outcome
    if not part.is_finished:
        return None
    outcome, maps = part.load(Outcome)
    return FinishedDiagnosis(outcome.summary, maps, outcome.scans)


def run_diagnosis(
    request: DiagnosisRequest, workers: Workers, observe: Observer = lambda step: None
) -> FinishedDiagnosis:
    """Diagnose a case, or continue a diagnosis.

    Parameters
    ----------
    request : DiagnosisRequest
    workers : Workers
    observe : callable
        Called with each `Step`.

    Raises
    ------
    InputError
        If the nominal model cannot be simulated.
    StoreError
        If a worker cannot use the store, or runs another version.
    ClusterError, TaskError
        If the workers cannot do the work; completed work is saved.
    Interrupted
        If the dispatcher is asked to stop.
    """
    require_plugins(workers, plugged_effects_of(request))
    store = DiagnosisStore(request)
    slow = frozenset(effect.name for effect in store.effects if effect.is_slow)
    phases = _Phases(request, workers, observe, slow)
    if workers.threads > 1 and not store.calibration.is_finished:
        phases.run("preparation", prepare_scan, [(name,) for name in store.preparations])
    (calibration,) = phases.run("calibration", calibrate_nominal, [()], by_scans=True)
    # Longest tasks first, so that none runs alone at the end.
    effects = sorted(request.effects, key=lambda name: name not in slow)
    numbers = range(calibration.scans)
    phases.run("effects", analyse_effect, [(e, number) for e in effects for number in numbers])
    while (left := phases.run("weighing", weigh_hypotheses, [()], by_scans=True)[0]).is_open:
        longest_first = sorted(left.wanted, key=slow.isdisjoint)
        phases.run("refits", fit_effects, [(names,) for names in longest_first], by_scans=True)
    diagnosis = finished(request)
    if diagnosis is None:
        raise TaskError(
            f"The diagnosis has ended, but is missing from {request.store}. Give a --store "
            "shared by the workers and this process."
        )
    return diagnosis


def plugged_effects_of(request: DiagnosisRequest) -> list[Plugin]:
    """Return the suspected effects from other distributions."""
    return [p for p in foreign_plugins() if p.group == "effects" and p.name in request.effects]


class _Phases:
    """The tasks of one diagnosis, sent phase by phase."""

    def __init__(
        self, request: DiagnosisRequest, workers: Workers, observe: Observer, slow: frozenset[str]
    ) -> None:
        self.request, self.workers, self.observe, self.slow = request, workers, observe, slow

    def run(
        self,
        phase: str,
        task: Callable[..., R],
        arguments: list[tuple[Any, ...]],
        by_scans: bool = False,
    ) -> list[R]:
        """Run a task for each of `arguments`; return the records in order of arrival.

        A task with `by_scans` receives its number of threads.
        """
        of, threads = len(arguments), self.workers.threads
        self.observe(Step(phase, 0, of))
        calls: list[tuple[str, tuple[Any, ...]]] = []
        for argument in arguments:
            spare = [_spare(threads, of, self._is_slow(argument))] if by_scans else []
            calls.append((_about(argument), (self.request, *argument, *spare)))
        records: list[R] = []
        for ending in self.workers.run(task, calls):
            record: R = value_of(ending, f"{phase} {ending.key}".strip())
            records.append(record)
            self.observe(Step(phase, len(records), of, ending.key, record))
        return records

    def _is_slow(self, arguments: tuple[Any, ...]) -> bool:
        """Check whether a task concerns a slow effect."""
        return bool(arguments) and not self.slow.isdisjoint(arguments[0])


def _spare(threads: int, tasks: int, is_slow: bool) -> int:
    """Return the number of threads for one of several tasks.

    Threads are shared evenly; if there will soon be fewer tasks than threads, a slow task starts
    with two, so that it does not run alone at the end.
    """
    even = max(1, threads // tasks)
    waited_for = tasks < 2 * threads and is_slow
    return max(even, min(2, threads)) if waited_for else even


def _about(arguments: tuple[Any, ...]) -> str:
    """Return a readable name of a task: "plate_tilt with friction"."""
    parts = (" with ".join(one) if isinstance(one, tuple) else str(one) for one in arguments)
    return ", ".join(part for part in parts if part)


PLAN_NODES = 2000


def request_plan(
    path: Path,
    store: Location,
    nodes: int = PLAN_NODES,
    spacing_mm: float = SETTINGS.points.spacing_mm,
    *,
    anyway: bool = False,
) -> PlanRequest:
    """Return only the request from `checked_plan`."""
    return checked_plan(path, store, nodes, spacing_mm, anyway=anyway)[0]


def checked_plan(
    path: Path,
    store: Location,
    nodes: int = PLAN_NODES,
    spacing_mm: float = SETTINGS.points.spacing_mm,
    *,
    anyway: bool = False,
) -> tuple[PlanRequest, list[Finding]]:
    """Read the source into the store, and return the request for the workers.

    Parameters
    ----------
    path : Path
        Folder of a case or of a study.
    store : str or Path
        Created if missing.
    nodes : int
        Number of nodes of the mesh.
    spacing_mm : float
        Spacing of points on the interfaces.
    anyway : bool
        Accept implausible inputs.

    Returns
    -------
    request : PlanRequest
    findings : list of Finding
        Findings of the plausibility checks.

    Raises
    ------
    InputError
        If the path cannot be planned.
    StoreError
        If the store cannot be used.
    """
    source = open_planned(path.expanduser().absolute(), store)
    findings = check_source(source, anyway=anyway)
    check_nodes(nodes, source)
    parts = TaskStore(store)
    name = add_source(source, parts)
    return named_plan(PlanRequest(str(parts.store.root), name, nodes, spacing_mm)), findings


def run_plan(request: PlanRequest, dispatcher: Dispatcher, observe: Observer) -> PlanSummary:
    """Plan an acquisition, or continue a plan.

    Raises
    ------
    InputError
        If a planned load cannot be simulated.
    StoreError
        If a worker cannot use the store.
    ClusterError, TaskError
        If the workers cannot do the work; completed work is saved.
    Interrupted
        If the dispatcher is asked to stop.
    """
    loads = dispatcher.call(list_loads, request).loads
    observe(Step("loads", 0, len(loads)))
    calls = [(name, (request, number)) for number, name in enumerate(loads)]
    for done, ending in enumerate(dispatcher.run(analyse_load, calls), start=1):
        record = value_of(ending, f"load {ending.key}")
        observe(Step("loads", done, len(loads), ending.key, record))
    observe(Step("weighing", 0, 1))
    return dispatcher.call(weigh_plan, request, dispatcher.threads)


class DiagnosisRecords:
    """An observer of `run_diagnosis` that sends each step to the scheduler.

    Parameters
    ----------
    client : distributed.Client
        Connected to the scheduler.
    place : Path
        Source or folder of the diagnosis; the tab shows its last part.
    """

    def __init__(self, client: Client, place: Path) -> None:
        self._events = SchedulerEvents(client)
        self._key = f"{socket.gethostname()}:{place.absolute()}"
        self._send("started", name=place.name)

    def __call__(self, step: Step) -> None:
        """Send the progress."""
        self._send("step", phase=step.phase, done=step.done, of=step.of, task=step.task)

    def finished(self, diagnosis: FinishedDiagnosis) -> None:
        """Send the verdict."""
        self._send("stopped", reason=diagnosis.summary.verdict)

    def _send(self, what: str, **more: Any) -> None:
        self._events.add({"what": what, "diagnosis": self._key, **more})
        self._events.send()


Hearer = Callable[[str, int], object]
"""Called with a fit, "plate_tilt with friction", and the number of its iteration."""


@contextmanager
def _iterations(client: Client, request: DiagnosisRequest, hear: Hearer | None) -> Iterator[None]:
    """Pass on the iterations that workers announce."""
    if hear is None:
        yield
        return
    topic = fit_topic(request)
    client.subscribe_topic(topic, lambda event: hear(event[1]["fit"], event[1]["iteration"]))
    try:
        yield
    finally:
        client.unsubscribe_topic(topic)


def run_and_tell(
    request: DiagnosisRequest,
    dispatcher: Dispatcher,
    place: Path,
    observe: Observer,
    hear: Hearer | None = None,
) -> FinishedDiagnosis:
    """Run a diagnosis like `run_diagnosis`, and report it to the scheduler.

    Parameters
    ----------
    place : Path
        See `DiagnosisRecords`.
    observe : callable
        Also called with each step.
    hear : callable, optional
        Called with the iterations of long fits, from another thread.

    Raises
    ------
    PalpateError, Interrupted
        As in `run_diagnosis`.
    """
    records = DiagnosisRecords(dispatcher.client, place)

    def observe_both(step: Step) -> None:
        observe(step)
        records(step)

    with _iterations(dispatcher.client, request, hear):
        diagnosis = run_diagnosis(request, dispatcher, observe_both)
    records.finished(diagnosis)
    return diagnosis
