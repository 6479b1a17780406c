"""Says on standard error how far a diagnosis is: one line for what takes long."""

import time
from typing import Any

from rich.console import Console
from rich.status import Status

from service.progress import clock
from service.report.words import number

LINE_EVERY_S = 10.0
_PHASES = {
    "calibration": "finding the nominal constants",
    "effects": "asking what every effect would do",
    "weighing": "weighing",
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

    def __call__(self, phase: str, done: int, of: int, told: dict[str, Any]) -> None:
        """Tell a step; see `service.diagnosis.run.Tell`."""
        if self._status is not None:
            self._status.update(f"{_PHASES[phase]}: {done} of {of}")
        now = time.monotonic()
        if phase == "weighing":
            return
        if done == 0:
            self._line(_PHASES[phase] + (f" ({of})" if of > 1 else ""))
        elif phase == "calibration":
            self._line(_calibrated(told))
        elif phase == "refits":
            self._line(f"{done} of {of} refits: {_refitted(told)}")
        elif done == of or now - self._last >= LINE_EVERY_S:
            self._line(f"{done} of {of} effects and scans")

    def _line(self, text: str) -> None:
        self._last = time.monotonic()
        spent = clock(self._last - self._begun)
        self.console.print(f"[{spent}] {text}", markup=False, highlight=False, soft_wrap=True)


def _calibrated(told: dict[str, Any]) -> str:
    constants = ", ".join(f"{n} {number(v)} kPa" for n, v in told["constants_kpa"].items())
    return f"calibrated at {told['points']} points: {constants}"


def _refitted(told: dict[str, Any]) -> str:
    names = told["asked"]
    if not told["found"]:
        return f"{names} could not be simulated"
    ending = "" if told["converged"] else ", not converged"
    return f"{names}, {told['iterations']} iterations{ending}"
