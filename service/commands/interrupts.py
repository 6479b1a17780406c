"""Lets a command be stopped by Ctrl-C, and continued."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer

from service.commands.settings import this_command

INTERRUPTED = 130
"""Exit code of a command that was stopped and can be continued."""


def interrupted() -> typer.Exit:
    """Say that nothing is lost; the exit to raise."""
    typer.echo(f"Interrupted; what is finished is kept. To continue: {this_command()}", err=True)
    return typer.Exit(INTERRUPTED)


@contextmanager
def stop_requests() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM; the second one interrupts at once."""
    requests: list[int] = []

    def note(number: int, frame: Any) -> None:
        requests.append(number)
        if len(requests) > 1:
            raise KeyboardInterrupt

    before = {s: signal.signal(s, note) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield requests
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
