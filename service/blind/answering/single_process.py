"""The task that diagnoses a whole case in one process."""

import time
from collections.abc import Callable, Iterator
from typing import Any

from palpate.service.cluster.dispatch import Ending, Task, TaskCalls
from palpate.service.cluster.submission import ready
from palpate.service.diagnosis.run import run
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest


def diagnose_alone(request: DiagnosisRequest) -> float:
    """Diagnose a case in this process, leave the outcome in the store, return the seconds spent.

    As many of these as there are workers keep all of them busy, while one diagnosis has
    phases of a single task; and each body is built by one process only.
    """
    begun = time.perf_counter()
    run(request, InThisProcess())
    return time.perf_counter() - begun


class InThisProcess:
    """A dispatcher for one who is a worker himself."""

    threads = 1

    def everywhere(self, task: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Run one task here, which is everywhere."""
        return {"this process": task(*arguments)}

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Run tasks one after the other; what they raise goes up unchanged."""
        for key, arguments in ready(calls):
            yield Ending(key, "returned", task(*arguments))
