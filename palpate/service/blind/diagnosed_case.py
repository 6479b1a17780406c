"""A case as a diagnosis sees it: the settings that name its scans, and the task that diagnoses it.

The task diagnoses a whole case in one process. Nothing here imports what makes, opens or scores a
case; a contract in pyproject.toml forbids it.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from palpate.service.cluster.task_dispatch import Ending, Task, TaskCalls, ready
from palpate.service.diagnosis.diagnosis_run import run_diagnosis
from palpate.storage.errors import InputError
from palpate.workers.file_keys import with_current_names
from palpate.workers.input_files import parse_yaml
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest

CASE_FILE = "case.yaml"
ALONG_Y = ("y", [0, 1, 0])


def read_case_settings(case: Path) -> dict[str, Any]:
    """Read the settings in a case file.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    path = case / CASE_FILE
    try:
        settings = with_current_names(parse_yaml(path.read_text(encoding="utf-8"), str(path)))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read: {error}.") from error
    return settings


def is_along_y(load: Mapping[str, Any]) -> bool:
    """Return True if a loaded scan was compressed along y, the default."""
    return load.get("axis", "y") in ALONG_Y


def diagnose_alone(request: DiagnosisRequest) -> float:
    """Diagnose a case in this process, storing the outcome, and return the seconds spent.

    One such task per worker keeps all workers busy, whereas a single diagnosis has phases with
    only one task. Each body is also built by only one process.
    """
    begun = time.perf_counter()
    run_diagnosis(request, InThisProcess())
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
