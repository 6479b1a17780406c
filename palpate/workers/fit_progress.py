"""Progress inside a long fit, for whoever listens in the thread that computes it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Listener = Callable[[int], object]
"""Receives the number of an iteration when it begins."""

_listener: ContextVar[Listener | None] = ContextVar("listener of fits", default=None)


@contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Tell a listener of every iteration of the fits in this block and thread."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def tell_iteration(number: int) -> None:
    """Tell the listener, if any, that an iteration begins."""
    listener = _listener.get()
    if listener is not None:
        listener(number)
