"""Errors between the driver and its cluster, and requests to stop.

::

    PalpateError
    |-- ClusterError      no scheduler, no workers, nothing finishes; exit code 2
    |-- TaskError         a preparation crashed on a worker; exit code 2
    `-- GenerationCrashError  all of a generation crashed for one reason; exit code 2

    Interrupted           the user asked to stop: no error; exit code 130

Ctrl-C and SIGTERM are collected until the current work is saved.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from palpate.storage.errors import PalpateError


class ClusterError(PalpateError):
    """A cluster that cannot do the work."""


class TaskError(PalpateError):
    """The crash of a task that a study cannot start without."""


class GenerationCrashError(PalpateError):
    """A crash of every candidate of a generation for the same reason.

    Parameters
    ----------
    message : str
    traceback : str
        Traceback of the first one, from its worker.
    """

    def __init__(self, message: str, traceback: str = "") -> None:
        super().__init__(message)
        self.traceback = traceback


class Interrupted(Exception):  # noqa: N818 - a request, not an error
    """A request to stop the study; completed evaluations are saved."""


_DEFAULTS = (signal.SIG_DFL, signal.default_int_handler)
_collected: list[int] | None = None


@contextmanager
def stop_requests(*, respect_handlers: bool = False) -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM; the second one interrupts at once.

    Nested calls share one list. Only the main thread receives signals; in other threads the
    list stays empty.

    Parameters
    ----------
    respect_handlers : bool
        Ignore signals for which the program has its own handlers.
    """
    global _collected
    if threading.current_thread() is not threading.main_thread():
        yield []
        return
    if _collected is not None:
        yield _collected
        return
    requests = _collected = []

    def note(number: int, frame: Any) -> None:
        requests.append(number)
        if len(requests) > 1:
            raise KeyboardInterrupt

    before = {
        number: signal.signal(number, note)
        for number in (signal.SIGINT, signal.SIGTERM)
        if not respect_handlers or signal.getsignal(number) in _DEFAULTS
    }
    try:
        yield requests
    finally:
        _collected = None
        for number, handler in before.items():
            signal.signal(number, handler)
