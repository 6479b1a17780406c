"""Limits on the number of tasks that a dispatcher may have on the cluster at once."""

from typing import Protocol

TASKS_PER_THREAD = 2
"""One runs and one waits, so no worker idles while an ending is saved."""


class Slots(Protocol):
    """Slots for tasks; a task holds one from submission until its release."""

    def take(self, threads: int) -> bool:
        """Take a slot on a cluster with `threads` threads; return False if none is free."""

    def give_back(self) -> None:
        """Release one slot."""


class OwnSlots:
    """All slots of a cluster, for its only dispatcher.

    Examples
    --------
    >>> slots = OwnSlots()
    >>> [slots.take(threads=1) for _ in range(3)]
    [True, True, False]
    """

    def __init__(self) -> None:
        self._held = 0

    def take(self, threads: int) -> bool:
        """See `Slots.take`."""
        if self._held >= slot_count(threads):
            return False
        self._held += 1
        return True

    def give_back(self) -> None:
        """See `Slots.give_back`."""
        self._held -= 1


def slot_count(threads: int) -> int:
    """Return the number of slots of a cluster; positive even without workers."""
    return TASKS_PER_THREAD * max(1, threads)
