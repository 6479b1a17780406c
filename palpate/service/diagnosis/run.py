"""A diagnosis from its source to its outcome: tasks are sent until no more are needed.

Every step is a task that stores its result under the digest of everything it depends on.
Running a diagnosis and continuing an interrupted one are the same.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from palpate.service.cluster.dispatch import Ending, Task, TaskCalls, value_of
from palpate.service.diagnosis.step import Observer, Step
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
    DiagnosisRequest,
    DiagnosisStore,
    Outcome,
    named,
)
from palpate.workers.tasks.sources import add_source, check_nodes, open_source
from palpate.workers.tasks.task_store import TaskStore

R = TypeVar("R")


class Workers(Protocol):
    """The workers: a `service.cluster.dispatch.Dispatcher`, or this process."""

    @property
    def threads(self) -> int:
        """Tasks that can run at once."""

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Run a task for each key and its arguments."""

    def everywhere(self, task: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Run a task on each current worker."""


@dataclass(frozen=True, eq=False)
class FinishedDiagnosis:
    """A completed diagnosis.

    Parameters
    ----------
    summary : Summary
    maps : dict of str to ndarray
        ``points`` (k, 3) in mm; ``interface`` (k,), 0 for the outline; ``before``,
        ``noise`` (standard deviation) and, if an effect is named, ``after``: residuals
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
    """Read the source into the store, and return the request for the workers.

    Parameters
    ----------
    source : Path or Source
        The source or its path; see `workers.tasks.sources.open_source`.
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


def run(
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
        if left.unread:
            phases.run("reading", read_noise_again, [(left.read_at,)], by_scans=True)
            continue
        longest_first = sorted(left.wanted, key=slow.isdisjoint)
        fits = [(names, left.read_at) for names in longest_first]
        phases.run("refits", fit_effects, fits, by_scans=True)
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
        """Run a task for each of `arguments`; return the records in order of arrival.

        A task with `by_scans` receives its number of threads.
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
