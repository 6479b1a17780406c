"""Measures how long the tasks of a diagnosis take, and projects that on more workers.

The tasks run one after another in this process, as they would on one worker; each phase ends
before the next begins. With N workers the tasks of a phase are given out in their order, each to
the worker that is free first, and a phase takes as long as its last worker: the bound of any
schedule without knowledge of the times (R. L. Graham, SIAM J. Appl. Math. 17 (1969) 416). What a
cluster adds is not in it: starting, sending, and what each worker loads for itself.
"""

import heapq
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from palpate.service.cluster.dispatch import Ending, Task, TaskCalls
from palpate.service.cluster.single_process import SingleProcess
from palpate.service.diagnosis.run import Step, request_for, run

WORKERS = (1, 2, 4, 12)


@dataclass(frozen=True, slots=True)
class PhaseTimes:
    """How long the tasks of one phase took, in s, in the order in which they were sent."""

    phase: str
    seconds: tuple[float, ...]

    def on(self, workers: int) -> float:
        """Return how long so many workers would take."""
        free = [0.0] * workers
        for seconds in self.seconds:
            heapq.heapreplace(free, free[0] + seconds)
        return max(free)


class _Timed(SingleProcess):
    """One process that makes preparations as tasks of their own, and notes how long each takes."""

    threads = 2  # With one, a process makes the preparations while it calibrates.

    def __init__(self) -> None:
        self.seconds: list[float] = []

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Run tasks one after another."""
        for call in calls:
            begun = time.perf_counter()
            (ending,) = super().run(task, [call])
            self.seconds.append(time.perf_counter() - begun)
            yield ending


def measure_diagnosis(
    source: Path, store: Path, nodes: int, tell: Callable[[PhaseTimes], object]
) -> list[PhaseTimes]:
    """Diagnose a case in this process, in an empty store; tell of each phase when it has ended.

    Raises
    ------
    InputError
        If the path cannot be diagnosed.
    """
    workers, phases = _Timed(), list[PhaseTimes]()

    def observe(step: Step) -> None:
        if step.done == step.of and workers.seconds:
            phases.append(PhaseTimes(step.phase, tuple(workers.seconds)))
            workers.seconds.clear()
            tell(phases[-1])

    run(request_for(source, store, nodes), workers, observe)
    return phases


def projected(phases: Sequence[PhaseTimes], workers: int) -> float:
    """Return how long all phases would take on so many workers, in s."""
    return sum(phase.on(workers) for phase in phases)
