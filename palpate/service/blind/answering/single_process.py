"""The task that diagnoses a whole case in one process."""

import time
from collections.abc import Callable, Iterator
from typing import Any

from palpate.service.cluster.dispatch import Ending, Task, TaskCalls
from palpate.service.cluster.submission import ready
from palpate.service.diagnosis.run import run
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest


def diagnose_alone(request: DiagnosisRequest) -> float:
    """Diagnose a case in this process, storing the outcome, and return the seconds spent.

    One such task per worker keeps all workers busy, whereas a single diagnosis has phases with
    only one task. Each body is also built by only one process.
    """
    begun = time.perf_counter()
    run(request, InThisProcess())
    return time.perf_counter() - begun


class InThisProcess:
    """A dispatcher that runs tasks inside a worker."""

    threads = 1

    def everywhere(self, task: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Run one task in this process, the only one."""
        return {"this process": task(*arguments)}

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Run tasks one after the other; their exceptions are passed on unchanged."""
        for key, arguments in ready(calls):
            yield Ending(key, "returned", task(*arguments))
