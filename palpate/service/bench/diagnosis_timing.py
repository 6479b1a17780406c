"""Timing of the tasks of a diagnosis, and a projection to more workers.

The tasks run one after another in this process, as they would on one worker; each phase ends
before the next begins. With N workers the tasks of a phase are assigned in order, each to the
first free worker, and a phase takes as long as its last worker: a bound for any schedule made
without knowing the times (R. L. Graham, SIAM J. Appl. Math. 17 (1969) 416). The overhead of a
cluster is not included: starting, sending, and data loaded by each worker.
"""

import heapq
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from palpate.service.cluster.task_dispatch import Ending, SingleProcess, Task, TaskCalls
from palpate.service.diagnosis.diagnosis_run import Step, request_for, run_diagnosis

WORKERS = (1, 2, 4, 12)


@dataclass(frozen=True, slots=True)
class PhaseTimes:
    """Durations of the tasks of one phase, in s, in the order in which they were sent."""

    phase: str
    seconds: tuple[float, ...]

    def on(self, workers: int) -> float:
        """Return the duration on a given number of workers, in s."""
        free = [0.0] * workers
        for seconds in self.seconds:
            heapq.heapreplace(free, free[0] + seconds)
        return max(free)


class _Timed(SingleProcess):
    """A single process that runs preparations as separate tasks and times every task."""

    threads = 2  # With one, the process would run the preparations within the calibration.

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
    """Diagnose a case in this process with an empty store, reporting each completed phase.

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

    run_diagnosis(request_for(source, store, nodes), workers, observe)
    return phases


def projected(phases: Sequence[PhaseTimes], workers: int) -> float:
    """Return the duration of all phases on a given number of workers, in s."""
    return sum(phase.on(workers) for phase in phases)
