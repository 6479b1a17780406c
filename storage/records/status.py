"""Defines the life of an evaluation.

::

    waiting --> running --+--> done        simulated and scored
       ^                  +--> diverged    no equilibrium was found: ranked last, never retried
       |                  +--> crashed     an exception, with its traceback: ranked last
       |                  `--> lost        its worker died: no verdict on the candidate
       |                         |
       `-------------------------'

Endings are journalled. On the next run of a study whatever has no ending is
asked for again.
"""

from enum import StrEnum


class Status(StrEnum):
    """Where an evaluation stands."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    DIVERGED = "diverged"
    CRASHED = "crashed"
    LOST = "lost"

    @property
    def is_ending(self) -> bool:
        """Return whether the search gets a score for it: done, diverged or crashed."""
        return self in (Status.DONE, Status.DIVERGED, Status.CRASHED)
