"""Progress of a diagnosis or of a plan."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Step:
    """The progress of a diagnosis or of a plan.

    Parameters
    ----------
    phase : {"preparation", "calibration", "effects", "weighing", "reading", "refits", "loads"}
        A plan has only "loads".
    done, of : int
        Completed tasks of the phase, and all of them; 0 when it begins.
    task : str
        Subject of the last task: "plate_tilt with friction". Empty when the phase begins.
    record : object
        Its result.
    """

    phase: str
    done: int
    of: int
    task: str = ""
    record: object = None


Observer = Callable[[Step], object]
"""Called at the beginning of a phase and after each of its tasks."""
