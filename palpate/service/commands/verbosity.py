"""Verbosity of commands: `palpate -q`, `-v` and `--log-level`."""

import logging
from typing import Literal

import typer

Level = Literal["debug", "info", "warning", "error"]
FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"

_quiet = False


def set_verbosity(*, quiet: bool, level: Level | None) -> None:
    """Set whether this command shows progress, and the level of its log messages.

    Parameters
    ----------
    quiet : bool
        No progress and no notes; results, warnings and errors remain.
    level : {"debug", "info", "warning", "error"} or None
        None writes messages only to the log file of a study.
    """
    global _quiet
    _quiet = quiet
    if level is None:
        return
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter(FORMAT))
    logger = logging.getLogger("palpate")
    logger.handlers = [handler]
    logger.setLevel(level.upper())


def is_quiet() -> bool:
    """Check whether the user asked for results only."""
    return _quiet


def note(text: str) -> None:
    """Print a note to standard error, unless the user asked for results only."""
    if not _quiet:
        typer.echo(text, err=True)
