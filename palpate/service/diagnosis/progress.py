"""Progress of a diagnosis or plan on standard error, with a line at least every ten seconds."""

import threading
import time

from rich.console import Console
from rich.status import Status

from palpate.service.diagnosis.step import Step
from palpate.service.formatting import number
from palpate.service.study.observers.progress import clock
from palpate.workers.tasks.diagnosis_store import (
    CalibrationRecord,
    JointFitRecord,
    PreparationRecord,
)
from palpate.workers.tasks.planning import LoadRecord

LINE_EVERY_S = 10.0
_PHASES = {
    "preparation": "measuring distances to the interfaces",
    "calibration": "fitting the nominal constants",
    "effects": "simulating every effect",
    "weighing": "weighing",
    "reading": "re-estimating the noise",
    "refits": "refitting the suspects",
    "loads": "simulating loads and the influence of every effect on them",
}


class DiagnosisProgress:
    """A line for each step, repeated during long ones; on a terminal, also a spinner.

    Parameters
    ----------
    console : rich.console.Console
        Console on standard error.
    every_s : float
        Longest time between lines, in s.
    """

    def __init__(self, console: Console, every_s: float = LINE_EVERY_S) -> None:
        self.console = console
        self.every_s = every_s
        self._begun = time.monotonic()
        self._last = self._begun
        self._phase = "starting"
        self._ended = threading.Event()
        self._waiting = threading.Thread(target=self._wait, daemon=True)
        self._status = Status("starting", console=console) if console.is_terminal else None

    def __enter__(self) -> "DiagnosisProgress":
        if self._status is not None:
            self._status.start()
        self._waiting.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self._waiting.join()
        if self._status is not None:
            self._status.stop()

    def __call__(self, step: Step) -> None:
        """Show the progress."""
        phase, done, of, record = step.phase, step.done, step.of, step.record
        self._phase = f"{_PHASES[phase]}: {done} of {of}"
        if self._status is not None:
            self._status.update(self._phase)
        now = time.monotonic()
        if phase == "weighing":
            return
        if done == 0:
            self._line(_PHASES[phase] + (f" ({of})" if of > 1 else ""))
        elif isinstance(record, CalibrationRecord):
            self._line(_calibrated(record))
        elif isinstance(record, PreparationRecord):
            return
        elif isinstance(record, JointFitRecord):
            self._line(f"{done} of {of} refits: {_fitted(step.task, record)}")
        elif isinstance(record, LoadRecord):
            ending = "" if record.simulated else ", not converged"
            self._line(f"{done} of {of} loads: {record.name}{ending}")
        elif done == of or now - self._last >= self.every_s:
            self._line(f"{done} of {of} effects and scans")

    def _wait(self) -> None:
        """Print a line after each long silence, until the diagnosis ends."""
        while not self._ended.wait(max(0.01, self._last + self.every_s - time.monotonic())):
            if time.monotonic() - self._last >= self.every_s:
                self._line(f"still {self._phase}")

    def _line(self, text: str) -> None:
        self._last = time.monotonic()
        spent = clock(self._last - self._begun)
        self.console.print(f"[{spent}] {text}", markup=False, highlight=False, soft_wrap=True)


def _calibrated(record: CalibrationRecord) -> str:
    constants = ", ".join(f"{n} {number(v)}" for n, v in record.constants.items())
    left_out = f" ({record.left_out} left out)" if record.left_out else ""
    return f"calibrated at {record.points} points{left_out}: {constants}"


def _fitted(effects: str, record: JointFitRecord) -> str:
    if not record.simulated:
        return f"{effects} could not be simulated"
    ending = "" if record.converged else ", not converged"
    return f"{effects}, {record.iterations} iterations{ending}"
