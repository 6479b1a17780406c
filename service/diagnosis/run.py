"""The course of a diagnosis: calibrate, look at every effect, refit until nothing is wanted.

Every step is a task that leaves its result in the store under the digest of all that
it depends on. Running a diagnosis and going on with an interrupted one are the same.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from service.dispatch import Asks, Ending, Task
from service.errors import ClusterError, TaskError
from storage.arrays import Arrays
from storage.errors import PalpateError
from storage.stores import open_store
from workers import examine
from workers.casebook import Casebook, Request, named
from workers.cases.build import NODES, POINT_SPACING_MM
from workers.effects.friction import FRICTION
from workers.effects.inclusion import INCLUSION
from workers.sources import open_source

Json = dict[str, Any]
# With more loaded scans than these, points are sparser: about as many residuals in all.
SCANS = 2
# What takes longest comes first, so that nobody waits for it at the end.
LONG = {FRICTION.name, INCLUSION.name}
Tell = Callable[[str, int, int, Json], None]
"""Told of each step: the phase, how many of its tasks are done and how many there are, and
what the last one said (empty when the phase begins)."""


class Workers(Protocol):
    """Who does the work: a `service.dispatch.Dispatcher`, or one process alone."""

    @property
    def threads(self) -> int:
        """Tasks that can run at once."""

    def run(self, task: Task, asks: Asks) -> Iterator[Ending]:
        """Run a task for each key and its arguments."""

    def meanwhile(self, task: Task, asks: Asks) -> AbstractContextManager[None]:
        """Run tasks beside others, for which nobody waits."""


@dataclass(frozen=True, eq=False)
class Found:
    """A finished diagnosis.

    Parameters
    ----------
    summary : dict
        See `workers.diagnosis.summary.summary`.
    maps : dict of str to ndarray
        ``points`` (k, 3) in mm; ``interface`` (k,), 0 for the outline; ``before``,
        ``noise`` (standard deviation) and, where an effect is accused, ``after``: residuals
        in mm, shape (scans, k).
    scans : list of str
        Names of the loaded scans.
    """

    summary: Json
    maps: Arrays
    scans: list[str]


def ask(
    path: Path,
    store: Path,
    nodes: int = NODES,
    spacing_mm: float | None = None,
    effects: Iterable[str] | None = None,
) -> Request:
    """What is asked of the workers; makes the store.

    Parameters
    ----------
    path : Path
        Of what is diagnosed, see `workers.sources.open_source`.
    store : Path
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
    path = path.expanduser().absolute()
    source = open_source(path)
    known = [e.name for e in source.effects]
    if spacing_mm is None:
        spacing_mm = POINT_SPACING_MM * math.sqrt(max(1.0, len(source.scans) / SCANS))
    request: Request = {
        "store": str(open_store(store).root),
        "source": str(path),
        "nodes": nodes,
        "spacing_mm": spacing_mm,
        "effects": known if effects is None else list(effects),
        "name": "",
    }
    return named(request)


def finished(request: Request) -> Found | None:
    """The diagnosis if the store has it."""
    book = Casebook(request)
    if not book.has("verdict"):
        return None
    maps, summary = book.load("verdict")
    return Found(summary, maps, list(book.source.scans))


def run(request: Request, workers: Workers, tell: Tell) -> Found:
    """Diagnose a case, from wherever it stands.

    Raises
    ------
    InputError
        If the nominal model cannot be simulated.
    StoreError
        If a worker cannot use the store, or sees another case or version.
    ClusterError, TaskError
        If the workers cannot do the work; what is finished is kept.
    Interrupted
        If the dispatcher is told to stop.
    """
    one = _Run(request, workers, tell)
    others = max(0, workers.threads - 1) if not Casebook(request).has("calibration") else 0
    with workers.meanwhile(examine.build_case, [(n, (request,)) for n in range(others)]):
        calibrated = one.phase("calibration", examine.calibrate_case, [()])[0]
    scans = range(calibrated["scans"])
    effects = sorted(request["effects"], key=lambda name: name not in LONG)
    one.phase("effects", examine.print_effect, [(e, s) for e in effects for s in scans])
    while True:
        told = one.phase("weighing", examine.weigh_case, [()])[0]
        if not told["wanted"]:
            break
        wanted = sorted(told["wanted"], key=LONG.isdisjoint)
        one.phase("refits", examine.refit_effects, [(names,) for names in wanted])
    found = finished(request)
    if found is None:
        raise TaskError(
            f"The diagnosis has ended, but {request['store']} does not hold it. Give a --store "
            "that workers and driver share."
        )
    return found


class _Run:
    """Sends the tasks of one diagnosis."""

    def __init__(self, request: Request, workers: Workers, tell: Tell) -> None:
        self.request, self.workers, self.tell = request, workers, tell

    def phase(self, name: str, task: Any, asked: list[tuple[Any, ...]]) -> list[Json]:
        """Run a task for each of `asked`; what they tell, in order of arrival."""
        self.tell(name, 0, len(asked), {})
        told: list[Json] = []
        asks = [(_named(which), (self.request, *which)) for which in asked]
        for ending in self.workers.run(task, asks):
            told.append(_value(name, ending))
            self.tell(name, len(told), len(asked), {"asked": ending.key} | told[-1])
        return told


def _named(which: tuple[Any, ...]) -> str:
    """A task as a reader calls it: "plate_tilt with friction"."""
    return ", ".join(" with ".join(w) if isinstance(w, list) else str(w) for w in which)


def _value(phase: str, ending: Ending) -> Json:
    if ending.value is not None:
        return ending.value
    if isinstance(ending.error, PalpateError):
        raise ending.error
    what = f"{phase} {ending.key}".strip()
    if ending.kind == "lost":
        raise ClusterError(
            f"The diagnosis lost a task ({what}): {ending.reason}. Give the workers more memory, "
            "or start fewer with --workers, and run it again: what is finished is kept."
        )
    raise TaskError(f"The diagnosis failed ({what}): {ending.reason}.\n{ending.traceback}")
