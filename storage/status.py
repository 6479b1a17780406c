"""The life of an evaluation.

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
        """Whether the search may be told: done, diverged or crashed."""
        return self in (Status.DONE, Status.DIVERGED, Status.CRASHED)

    @property
    def may_become(self) -> frozenset["Status"]:
        """What can follow."""
        return _NEXT[self]


_NEXT = {
    Status.WAITING: frozenset({Status.RUNNING}),
    Status.RUNNING: frozenset({Status.DONE, Status.DIVERGED, Status.CRASHED, Status.LOST}),
    Status.LOST: frozenset({Status.WAITING}),
    Status.DONE: frozenset[Status](),
    Status.DIVERGED: frozenset[Status](),
    Status.CRASHED: frozenset[Status](),
}
