"""States of an evaluation.

::

    waiting --> running --+--> done        simulated and scored
       ^                  +--> diverged    no equilibrium was found: ranked last, never retried
       |                  +--> crashed     an exception, with its traceback: ranked last
       |                  `--> lost        its worker died: no verdict on the candidate
       |                         |
       `-------------------------'

Endings are written to the journal. The next run of a study resubmits every candidate
without an ending.
"""

from enum import StrEnum


class Status(StrEnum):
    """State of an evaluation."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    DIVERGED = "diverged"
    CRASHED = "crashed"
    LOST = "lost"

    @property
    def is_ending(self) -> bool:
        """Return True if the search gets a score for it: done, diverged or crashed."""
        return self in (Status.DONE, Status.DIVERGED, Status.CRASHED)
