"""Progress of a diagnosis for the scheduler; see `service.cluster.dask_tab`."""

import socket
from pathlib import Path
from typing import Any

from distributed import Client

from palpate.service.cluster.dispatch import Dispatcher
from palpate.service.diagnosis.run import FinishedDiagnosis, run
from palpate.service.diagnosis.step import Observer, Step
from palpate.service.study.observers.dask_records import SchedulerEvents
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest


class DiagnosisRecords:
    """An observer of `service.diagnosis.run.run` that sends each step to the scheduler.

    Parameters
    ----------
    client : distributed.Client
        Connected to the scheduler.
    place : Path
        Source or folder of the diagnosis; the tab shows its last part.
    """

    def __init__(self, client: Client, place: Path) -> None:
        self._events = SchedulerEvents(client)
        self._key = f"{socket.gethostname()}:{place.absolute()}"
        self._send("started", name=place.name)

    def __call__(self, step: Step) -> None:
        """Send the progress."""
        self._send("step", phase=step.phase, done=step.done, of=step.of, task=step.task)

    def finished(self, diagnosis: FinishedDiagnosis) -> None:
        """Send the verdict."""
        self._send("stopped", reason=diagnosis.summary.verdict)

    def _send(self, what: str, **more: Any) -> None:
        self._events.add({"what": what, "diagnosis": self._key, **more})
        self._events.send()


def run_and_tell(
    request: DiagnosisRequest, dispatcher: Dispatcher, place: Path, observe: Observer
) -> FinishedDiagnosis:
    """Run a diagnosis like `service.diagnosis.run.run`, and report it to the scheduler.

    Parameters
    ----------
    place : Path
        See `DiagnosisRecords`.
    observe : callable
        Also called with each step.

    Raises
    ------
    PalpateError, Interrupted
        As in `run`.
    """
    records = DiagnosisRecords(dispatcher.client, place)

    def observe_both(step: Step) -> None:
        observe(step)
        records(step)

    diagnosis = run(request, dispatcher, observe_both)
    records.finished(diagnosis)
    return diagnosis
