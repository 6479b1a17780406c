"""Rows of the tab of `service.cluster.dask_tab`: one study, one diagnosis."""

import math
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

# Topics of the scheduler's events that contain records of studies.
TOPIC = "palpate"

MOST_GENERATIONS = 200


class IdleTime:
    """The accumulated time during which worker threads have no task.

    Parameters
    ----------
    clock : callable
        Returns the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._since = clock()
        self._threads = self._busy = 0
        self._idle_s = self._all_s = 0.0

    def note(self, tasks_and_threads: list[tuple[int, int]]) -> None:
        """Record the current tasks and threads of each worker."""
        self.so_far()
        self._threads = sum(threads for _, threads in tasks_and_threads)
        self._busy = sum(min(pair) for pair in tasks_and_threads)

    def so_far(self) -> tuple[float, float]:
        """Return idle seconds and total seconds, summed over threads."""
        now = self._clock()
        passed, self._since = now - self._since, now
        self._idle_s += passed * (self._threads - self._busy)
        self._all_s += passed * self._threads
        return self._idle_s, self._all_s


@dataclass
class StudyRow:
    """One study in the tab.

    Parameters
    ----------
    name : str
    most : int
        Number of evaluations if the search runs to its last generation.
    client : str
        The client that runs the study.
    state : str
        The state as text.
    best_score : float
        Score of the best candidate so far, lower is better; infinite before the first.
    endings : Counter of str
        Number of evaluations by ending.
    stages : Counter of str
        Seconds by stage, of evaluations computed in this run.
    generations : deque of (int, float)
        Number, from 1, and share of the workers' time without a task up to its barrier.
    begun : tuple of float
        Idle and total seconds at the start of the generation.
    computed : bool
        Whether any candidate of the generation was computed; if not, it has no idle time to report.
    """

    name: str
    most: int
    client: str
    state: str = "preparing"
    best_score: float = math.inf
    endings: Counter[str] = field(default_factory=Counter)
    stages: Counter[str] = field(default_factory=Counter)
    generations: deque[tuple[int, float]] = field(
        default_factory=lambda: deque(maxlen=MOST_GENERATIONS)
    )
    begun: tuple[float, float] = (0.0, 0.0)
    computed: bool = False

    def add(self, record: dict[str, Any], idle: IdleTime) -> None:
        """Add one record of `service.study.observers.dask_records.DaskRecords`."""
        what = record["what"]
        if what == "ended":
            self.endings[record["status"]] += 1
            self.computed |= record["computed"]
            self.stages.update(record["seconds"])
            self.best_score = math.inf if record["best_score"] is None else record["best_score"]
        elif what == "generation begun":
            self.state = f"generation {record['number'] + 1}"
            self.begun, self.computed = idle.so_far(), False
        elif what == "generation ended" and self.computed:
            idle_s, all_s = (
                now - then for now, then in zip(idle.so_far(), self.begun, strict=True)
            )
            if all_s > 0.0:
                self.generations.append((record["number"] + 1, idle_s / all_s))
        elif what == "stopped":
            self.state = record["reason"]
            self.client = ""


@dataclass
class DiagnosisRow:
    """One diagnosis in the tab.

    Parameters
    ----------
    name : str
    client : str
        The client that runs the diagnosis.
    state : str
        As text: the phase and its progress, finally the verdict.
    tasks : int
        Number of finished tasks.
    begun : tuple of float
        Idle and total seconds of the workers at the start.
    idle : float or None
        Share of the workers' time without a task since then; None if unknown.
    """

    name: str
    client: str
    begun: tuple[float, float]
    state: str = "reading"
    tasks: int = 0
    idle: float | None = None

    def add(self, record: dict[str, Any], idle: IdleTime) -> None:
        """Add one record of `service.diagnosis.dask_observer.DiagnosisRecords`."""
        if record["what"] == "step":
            done, of, task = record["done"], record["of"], record["task"]
            self.tasks += done > 0
            self.state = f"{record['phase']}, {done} of {of}" + (f": {task}" if task else "")
        elif record["what"] == "stopped":
            self.state, self.client = record["reason"], ""
        idle_s, all_s = (now - then for now, then in zip(idle.so_far(), self.begun, strict=True))
        if all_s > 0.0:
            self.idle = idle_s / all_s
