"""Says how many tasks a dispatcher may have on the cluster at once."""

from typing import Protocol

TASKS_PER_THREAD = 2
"""One runs and one waits, so that no worker idles while an ending is journalled."""


class Slots(Protocol):
    """Slots for tasks; a task has one from when it is sent until it is released."""

    def take(self, threads: int) -> bool:
        """Take a slot on a cluster of so many threads; False if there is none now."""

    def give_back(self) -> None:
        """Give one back."""


class OwnSlots:
    """All slots of a cluster, for the one dispatcher that uses it.

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
    """Return the slots of a cluster; some even where there is no worker yet."""
    return TASKS_PER_THREAD * max(1, threads)
