"""Says on standard error how far a diagnosis is: one line for what takes long."""

import time

from rich.console import Console
from rich.status import Status

from service.diagnosis.run import Step
from service.formatting import number
from service.progress import clock
from workers.tasks.diagnosis_store import CalibrationRecord, JointFitRecord, PreparationRecord

LINE_EVERY_S = 10.0
_PHASES = {
    "preparation": "measuring distances to the interfaces",
    "calibration": "finding the nominal constants",
    "effects": "asking what every effect would do",
    "weighing": "weighing",
    "reading": "reading the noise again",
    "refits": "refitting the suspects",
}


class DiagnosisProgress:
    """A line for each step; on a terminal also a spinner with the phase.

    Parameters
    ----------
    console : rich.console.Console
        On standard error.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self._begun = time.monotonic()
        self._last = 0.0
        self._status = Status("starting", console=console) if console.is_terminal else None

    def __enter__(self) -> "DiagnosisProgress":
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._status is not None:
            self._status.stop()

    def __call__(self, step: Step) -> None:
        """Say how far it is."""
        phase, done, of, record = step.phase, step.done, step.of, step.record
        if self._status is not None:
            self._status.update(f"{_PHASES[phase]}: {done} of {of}")
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
        elif done == of or now - self._last >= LINE_EVERY_S:
            self._line(f"{done} of {of} effects and scans")

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
