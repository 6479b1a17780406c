"""Submissions of a dispatcher: one task and its attempts."""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal

Call = tuple[Any, tuple[Any, ...]]
"""A key, and the arguments of a task."""


class Later(Enum):
    """Marker for a call that has to wait until some task has ended."""

    NOT_YET = "not yet"


NOT_YET = Later.NOT_YET
TaskCalls = Iterable[Call | Literal[Later.NOT_YET]]
"""Calls, read only as fast as tasks end; `NOT_YET` is tried again after the next ending."""


def ready(calls: TaskCalls) -> Iterator[Call]:
    """Yield calls; one that is not ready is tried again at once."""
    for call in calls:
        if call is not NOT_YET:
            yield call


@dataclass
class Submission:
    """A task with the number of times it was sent."""

    key: Any
    arguments: tuple[Any, ...]
    attempts: int = 0
    future: Any = field(default=None, repr=False)


class WaitingCalls:
    """Calls that have not been sent; one is read ahead."""

    def __init__(self, calls: TaskCalls) -> None:
        self._calls: Iterator[Call | Literal[Later.NOT_YET]] = iter(calls)
        self._next = next(self._calls, None)

    def __bool__(self) -> bool:
        """Return True if there may be more calls."""
        return self._next is not None

    @property
    def ready(self) -> bool:
        """Return True if a call can be sent now."""
        if self._next is NOT_YET:
            self._next = next(self._calls, None)
        return self._next is not None and self._next is not NOT_YET

    def pop(self) -> Submission:
        """Return the next call."""
        first, self._next = self._next, next(self._calls, None)
        assert isinstance(first, tuple)
        return Submission(*first)


class Patience:
    """The times when a task last ended and when a worker was last present."""

    def __init__(self) -> None:
        self.ended = self.worked = time.monotonic()

    def restart(self) -> None:
        """Reset both times."""
        self.ended = self.worked = time.monotonic()
