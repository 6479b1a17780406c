"""What a diagnosis prints on a console: its progress, and the results of a bench experiment.

The progress of a diagnosis or plan goes to standard error, with a line at least every ten seconds.
"""

import math
import threading
import time
from collections.abc import Iterator, Mapping

from rich.console import Console
from rich.status import Status

from palpate.service.diagnosis.diagnosis_run import Step
from palpate.service.diagnosis.diagnosis_words import agreement, least_length, spoken
from palpate.service.diagnosis.magnitude_words import decimals, difference, measured, signed
from palpate.service.number_formatting import NONE, number
from palpate.service.study.study_progress import clock
from palpate.workers.diagnosis.outcome.diagnosis_summary import PredictedPoint, Summary
from palpate.workers.tasks.diagnosis_store import (
    CalibrationRecord,
    JointFitRecord,
    PreparationRecord,
)
from palpate.workers.tasks.plan_tasks import LoadRecord

LINE_EVERY_S = 10.0
_PHASE_WORDS = {
    "preparation": "measuring distances to the interfaces",
    "calibration": "fitting the nominal constants",
    "effects": "simulating every effect",
    "weighing": "comparing the effects",
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
        self._fits: dict[str, int] = {}
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
        count = f": {done} of {of}" if of > 1 else ""
        self._phase = _PHASE_WORDS[phase] + count
        self._fits = {fit: n for fit, n in self._fits.items() if done and fit != step.task}
        self._show()
        now = time.monotonic()
        if phase == "weighing":
            return
        if done == 0:
            self._line(_PHASE_WORDS[phase] + (f" ({of})" if of > 1 else ""))
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

    def iterated(self, fit: str, iteration: int) -> None:
        """Note that an iteration of a fit has begun; called from another thread."""
        self._fits = self._fits | {fit: iteration}
        self._show()

    def _state(self) -> str:
        """Return the phase with the iterations of the fits that are running."""
        fits = (f"{fit} iteration {n}".strip() for fit, n in sorted(self._fits.items()))
        return ", ".join([self._phase, *fits])

    def _show(self) -> None:
        if self._status is not None:
            self._status.update(self._state())

    def _wait(self) -> None:
        """Print a line after each long silence, until the diagnosis ends."""
        while not self._ended.wait(max(0.01, self._last + self.every_s - time.monotonic())):
            if time.monotonic() - self._last >= self.every_s:
                self._line(f"still {self._state()}")

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


# Smaller relative changes in a constant are not reported.
SMALL_CHANGE = 0.02
# Number of points printed for a state; the page has all.
SHOWN_POINTS = 12


def experiment_lines(summary: Summary) -> Iterator[str]:
    """Yield forces, absorbed effects and predicted states; nothing for scans."""
    if summary.predictions is None:
        return
    yield from summary.data_notes
    yield from _force_lines(summary)
    for effect in summary.hidden or ():
        for name, kpa in effect.constants_kpa.items():
            if abs(kpa["with"] / kpa["without"] - 1) < SMALL_CHANGE:
                continue
            yield (
                f"With {spoken(effect.name)} ({_effect_size(effect.size)}) {name} would be "
                f"{number(kpa['with'], 3)} kPa instead of {number(kpa['without'], 3)} kPa: these "
                "states cannot distinguish the two."
            )
    least_mm = least_length(summary.gap_mm)
    for state in summary.predictions:
        yield f"Expected at {state.state}, along x, y and z of the body:"
        for point in state.points[:SHOWN_POINTS]:
            parts = zip(point.displacement_mm, point.sd_mm, strict=True)
            moved = ", ".join(
                NONE if math.isnan(value) else measured(value, max(sd, least_mm), "mm")
                for value, sd in parts
            )
            yield f"  {point.name}: {moved}{_measured(point, least_mm)}"
        if len(state.points) > SHOWN_POINTS:
            more = len(state.points) - SHOWN_POINTS
            yield f"  and {more} further points: see the page, or --json"
        if compared := agreement(state):
            yield f"  {compared}"
        for reaction in state.reactions:
            force = measured(reaction.force_n, reaction.sd_n, "N")
            yield f"  force on {reaction.place}: {force}"


def _measured(point: PredictedPoint, least_mm: float) -> str:
    """Return the measured displacement of a held-out state; empty if nothing was measured."""
    seen = point.measured_mm
    if seen is None or all(math.isnan(value) for value in seen):
        return ""
    texts = (NONE if math.isnan(value) else signed(value, decimals(least_mm)) for value in seen)
    return f"; measured {', '.join(texts)} mm"


def _force_lines(summary: Summary) -> Iterator[str]:
    """Yield a line for each measured force."""
    for state in summary.markers or ():
        for one in state.reactions:
            left = one.before_n if one.after_n is None else one.after_n
            read = measured(one.force_n, one.sd_n, "N")
            yield (
                f"Force on {one.place} at {state.state}: {read}; the model is "
                f"off by {difference(left, one.sd_n)} N"
            )


def _effect_size(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in values.items())
