"""A diagnosis from its source to its outcome: which tasks are sent, until nothing is wanted.

Every step is a task that leaves its result in the store under the digest of all that
it depends on. Running a diagnosis and going on with an interrupted one are the same.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from palpate.service.cluster.dispatch import Ending, Task, TaskCalls, value_of
from palpate.service.errors import TaskError
from palpate.service.study.plugin_use import require_plugins
from palpate.storage.backends.places import Location
from palpate.storage.stores.arrays import Arrays
from palpate.workers.diagnosis.outcome.source import Source
from palpate.workers.diagnosis.schema.summary import Summary
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.plugins import Plugin, foreign_plugins
from palpate.workers.tasks.diagnosis import (
    analyse_effect,
    calibrate_nominal,
    fit_effects,
    prepare_scan,
    read_noise_again,
    weigh_hypotheses,
)
from palpate.workers.tasks.diagnosis_store import (
    CalibrationRecord,
    DiagnosisRequest,
    DiagnosisStore,
    JointFitRecord,
    Outcome,
    named,
)
from palpate.workers.tasks.sources import add_source, check_nodes, open_source
from palpate.workers.tasks.task_store import TaskStore

R = TypeVar("R")


@dataclass(frozen=True)
class Step:
    """How far a diagnosis is.

    Parameters
    ----------
    phase : {"preparation", "calibration", "effects", "weighing", "reading", "refits"}
    done, of : int
        Tasks of the phase that have ended, and all of them; none when it begins.
    task : str
        What the last one was about: "plate_tilt with friction". Empty when the phase begins.
    record : object
        What it returned.
    """

    phase: str
    done: int
    of: int
    task: str = ""
    record: CalibrationRecord | JointFitRecord | object = None


Observer = Callable[[Step], object]


class Workers(Protocol):
    """Who does the work: a `service.cluster.dispatch.Dispatcher`, or one process alone."""

    @property
    def threads(self) -> int:
        """Tasks that can run at once."""

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Run a task for each key and its arguments."""

    def everywhere(self, task: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Run a task on each worker that is there now."""


@dataclass(frozen=True, eq=False)
class FinishedDiagnosis:
    """A diagnosis that has ended.

    Parameters
    ----------
    summary : Summary
    maps : dict of str to ndarray
        ``points`` (k, 3) in mm; ``interface`` (k,), 0 for the outline; ``before``,
        ``noise`` (standard deviation) and, where an effect is accused, ``after``: residuals
        in mm, shape (scans, k).
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
    """Bring what is diagnosed into the store, and return what is asked of the workers.

    Parameters
    ----------
    source : Path or Source
        What is diagnosed, or where it lies; see `workers.tasks.sources.open_source`.
    store : str or Path
        Made where it is missing.
    nodes : int
        Of the mesh.
    spacing_mm : float, optional
        Between points on the interfaces; more where there are more than two loaded scans.
    effects : iterable of str, optional
        Those that are suspected; the whole catalogue of the source.

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
    """Return a diagnosis that begins with these statements."""
    summary = replace(diagnosis.summary, caveats=caveats or None)
    return replace(diagnosis, summary=summary)


def finished(request: DiagnosisRequest) -> FinishedDiagnosis | None:
    """Return the diagnosis if the store has it."""
    part = DiagnosisStore(request).outcome
    if not part.is_finished:
        return None
    outcome, maps = part.load(Outcome)
    return FinishedDiagnosis(outcome.summary, maps, outcome.scans)


def run(
    request: DiagnosisRequest, workers: Workers, observe: Observer = lambda step: None
) -> FinishedDiagnosis:
    """Diagnose a case, from wherever it stands.

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
        If the workers cannot do the work; what is finished is kept.
    Interrupted
        If the dispatcher is told to stop.
    """
    require_plugins(workers, plugged_effects_of(request))
    store = DiagnosisStore(request)
    slow = frozenset(effect.name for effect in store.effects if effect.is_slow)
    phases = _Phases(request, workers, observe, slow)
    if workers.threads > 1 and not store.calibration.is_finished:
        phases.run("preparation", prepare_scan, [(name,) for name in store.preparations])
    (calibration,) = phases.run("calibration", calibrate_nominal, [()], by_scans=True)
    # The longest tasks come first, so that nobody waits for them at the end.
    effects = sorted(request.effects, key=lambda name: name not in slow)
    numbers = range(calibration.scans)
    phases.run("effects", analyse_effect, [(e, number) for e in effects for number in numbers])
    while (left := phases.run("weighing", weigh_hypotheses, [()], by_scans=True)[0]).is_open:
        if left.unread:
            phases.run("reading", read_noise_again, [(left.read_at,)], by_scans=True)
            continue
        longest_first = sorted(left.wanted, key=slow.isdisjoint)
        fits = [(names, left.read_at) for names in longest_first]
        phases.run("refits", fit_effects, fits, by_scans=True)
    diagnosis = finished(request)
    if diagnosis is None:
        raise TaskError(
            f"The diagnosis has ended, but {request.store} does not hold it. Give a --store "
            "that workers and driver share."
        )
    return diagnosis


def plugged_effects_of(request: DiagnosisRequest) -> list[Plugin]:
    """Return the effects of other distributions that a diagnosis suspects."""
    return [p for p in foreign_plugins() if p.group == "effects" and p.name in request.effects]


class _Phases:
    """Sends the tasks of one diagnosis, phase after phase."""

    def __init__(
        self,
        request: DiagnosisRequest,
        workers: Workers,
        observe: Observer,
        slow: frozenset[str],
    ) -> None:
        self.request, self.workers, self.observe, self.slow = request, workers, observe, slow

    def run(
        self,
        phase: str,
        task: Callable[..., R],
        arguments: list[tuple[Any, ...]],
        by_scans: bool = False,
    ) -> list[R]:
        """Run a task for each of `arguments`; its records in order of arrival.

        One that goes `by_scans` is told how many threads it may have.
        """
        of, threads = len(arguments), self.workers.threads
        self.observe(Step(phase, 0, of))
        calls: list[tuple[str, tuple[Any, ...]]] = []
        for one in arguments:
            spare = [_spare(threads, of, self._is_slow(one))] if by_scans else []
            calls.append((_about(one), (self.request, *one, *spare)))
        records: list[R] = []
        for ending in self.workers.run(task, calls):
            record: R = value_of(ending, f"{phase} {ending.key}".strip())
            records.append(record)
            self.observe(Step(phase, len(records), of, ending.key, record))
        return records

    def _is_slow(self, arguments: tuple[Any, ...]) -> bool:
        """Return whether a task is about an effect that takes long."""
        return bool(arguments) and not self.slow.isdisjoint(arguments[0])


def _spare(threads: int, tasks: int, is_slow: bool) -> int:
    """Return how many threads one of some tasks may have.

    An even share; and where soon there are fewer tasks than threads, one that takes long begins
    with two, so that nobody waits for it at the end.
    """
    even = max(1, threads // tasks)
    waited_for = tasks < 2 * threads and is_slow
    return max(even, min(2, threads)) if waited_for else even


def _about(arguments: tuple[Any, ...]) -> str:
    """Name a task as a reader does: "plate_tilt with friction"."""
    parts = (" with ".join(one) if isinstance(one, tuple) else str(one) for one in arguments)
    return ", ".join(part for part in parts if part)
