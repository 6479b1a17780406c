"""Estimated time of the missing parts, from the recorded times of similar parts."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from palpate.service.number_formatting import duration
from palpate.service.thesis.thesis_experiments import SearchRun, ThesisRequest, phases_of
from palpate.workers.tasks.thesis_tasks import Request, machine

RECORDED = Path(__file__).with_name("recorded_seconds.json")

Seconds = dict[str, float]
"""Processor seconds of a part, by kind."""

Ways = list[tuple[str, float]]
"""Kinds of parts from which to derive a time, the most similar first, with multipliers."""


@dataclass(frozen=True)
class Recorded:
    """Recorded times of parts.

    Parameters
    ----------
    machine : str
        The machine on which they ran.
    seconds : mapping of str to float
        Processor seconds of one part or search, by kind; for searches, of the workers.
    """

    machine: str
    seconds: Mapping[str, float]


@dataclass(frozen=True)
class Estimate:
    """The estimated time of the missing parts.

    Parameters
    ----------
    cpu_s : float
        Processor seconds of the missing parts.
    workers : int
    missing, of : int
        Numbers of parts and searches.
    machines : tuple of str
        Machines on which similar parts were timed.
    unknown : int
        Number of missing parts of kinds that have not been timed at this scale.
    """

    cpu_s: float
    workers: int
    missing: int
    of: int
    machines: tuple[str, ...]
    unknown: int

    @property
    def sentence(self) -> str:
        """Return the estimate as a sentence."""
        if not self.missing:
            return f"All {self.of} parts are in the store: nothing to compute."
        known = self.missing - self.unknown
        parts = f"{self.missing} of {self.of} parts are missing"
        if not known:
            return f"{parts}; none of them has been timed at this scale yet."
        where = " and ".join(self.machines)
        text = (
            f"{parts}: about {duration(self.cpu_s / self.workers)} on {self.workers} free "
            f"core{'s' if self.workers > 1 else ''} (timed on {where})"
        )
        if self.unknown:
            return f"{text}, excluding {self.unknown} that have not been timed at this scale."
        return f"{text}."


def estimate(request: ThesisRequest, workers: int) -> Estimate:
    """Return the estimated time of all parts missing in the store.

    Times of parts of the same kind in the store, which were measured here, take precedence over
    the shipped ones.
    """
    store = str(request.store)
    parts = {r.part.name: r for e in request.experiments for r in parts_of(e, store, request.scale)}
    here = _seconds(parts.values(), request.searches)
    shipped = shipped_seconds(request.scale)
    wanted: list[Ways] = [[(r.kind, 1.0)] for r in parts.values() if not r.part.is_finished]
    searches = request.searches
    for run in searches:
        if not run.is_finished:
            left = max(0.0, 1.0 - run.evaluations / run.most_evaluations)
            wanted.append([(kind_of(run), left), (_kind_of_one(run), left * run.most_evaluations)])
    cpu_s, unknown, machines = 0.0, 0, set()
    for ways in wanted:
        cost = _cost(ways, here, shipped)
        if cost is None:
            unknown += 1
        else:
            cpu_s += cost[0]
            machines.add(cost[1])
    of = len(parts) + len(searches)
    return Estimate(cpu_s, max(1, workers), len(wanted), of, tuple(sorted(machines)), unknown)


def parts_of(experiment: str, store: str, scale: str) -> list[Request]:
    """Return all parts of an experiment except its studies."""
    return [r for phase in phases_of(experiment, store, scale) for r in phase.requests]  # type: ignore[arg-type]


def kind_of(run: SearchRun) -> str:
    """Return the kind of a search under which its time is recorded."""
    return f"{run.experiment}, {run.target}, {run.spec.search.strategy}"


def _kind_of_one(run: SearchRun) -> str:
    """Return the kind of the part that does the same work as one candidate of a search."""
    if run.experiment == "cornea":
        return "candidate, cornea"
    return f"vary, {'X3' if run.target == 'X3' else 'X1'}"


def _cost(ways: Ways, here: Seconds, shipped: Recorded | None) -> tuple[float, str] | None:
    """Return seconds and machine of the first kind that was timed, preferably here."""
    for kind, times in ways:
        if kind in here:
            return times * here[kind], "this machine"
        if shipped is not None and kind in shipped.seconds:
            return times * shipped.seconds[kind], shipped.machine
    return None


def recorded_here(request: ThesisRequest) -> Recorded:
    """Return the times of the parts in the store, by kind."""
    store = str(request.store)
    parts = [r for e in request.experiments for r in parts_of(e, store, request.scale)]
    return Recorded(machine(), _seconds(parts, request.searches))


def shipped_seconds(scale: str) -> Recorded | None:
    """Return the times shipped with Palpate; None if there are none for this scale."""
    text = json.loads(RECORDED.read_text(encoding="utf-8"))
    found = text["seconds"].get(scale)
    return None if found is None else Recorded(text["machine"], found)


def _seconds(parts: Iterable[Request], runs: Iterable[SearchRun]) -> Seconds:
    """Return the mean processor seconds of a finished part, by kind.

    A few take ten times as long as most, which a mean accounts for.
    """
    by_kind: dict[str, list[float]] = {}
    for request in parts:
        if request.part.is_finished:
            by_kind.setdefault(request.kind, []).append(request.spent.cpu_s)
    for run in runs:
        results = run.results()
        if results is not None and results.stages:
            total = sum(time.total_s for time in results.stages.values())
            by_kind.setdefault(kind_of(run), []).append(total)
    return {kind: fmean(seconds) for kind, seconds in by_kind.items()}
