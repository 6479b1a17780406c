"""Commands that Ctrl-C stops and that can be continued."""

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
    """Print how to continue, and return the exit to raise."""
    typer.echo(f"Interrupted; completed work is saved. To continue: {this_command()}", err=True)
    return typer.Exit(INTERRUPTED)


@contextmanager
def interruptible() -> Iterator[list[int]]:
    """Stop the enclosed work on Ctrl-C or SIGTERM; exit with 130 and print how to continue."""
    with stop_requests() as requests:
        try:
            yield requests
        except (Interrupted, KeyboardInterrupt):
            raise interrupted() from None
