"""Lets a command be stopped by Ctrl-C, and continued."""

from collections.abc import Iterator
from contextlib import contextmanager

import typer

from palpate.service.commands.settings import this_command
from palpate.service.errors import Interrupted
from palpate.service.interrupts import stop_requests

__all__ = ["INTERRUPTED", "interrupted", "interruptible", "stop_requests"]

INTERRUPTED = 130
"""Exit code of a command that was stopped and can be continued."""


def interrupted() -> typer.Exit:
    """Print that nothing is lost, and return the exit to raise."""
    typer.echo(f"Interrupted; what is finished is kept. To continue: {this_command()}", err=True)
    return typer.Exit(INTERRUPTED)


@contextmanager
def interruptible() -> Iterator[list[int]]:
    """Stop the work within at Ctrl-C or SIGTERM, and leave with 130 and how to continue."""
    with stop_requests() as requests:
        try:
            yield requests
        except (Interrupted, KeyboardInterrupt):
            raise interrupted() from None
