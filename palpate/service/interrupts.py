"""Requests to stop: Ctrl-C and SIGTERM, collected until the current work is saved."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

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
