"""The command line: commands imported on demand, options not given, verbosity, Ctrl-C.

A command group lists the summaries of its commands and imports the module of one only when it is
run. Verbosity is set by `palpate -q`, `-v` and `--log-level`. Options that are not given come from
the environment, else have defaults::

    PALPATE_STORE        --store
    PALPATE_SCHEDULER    --scheduler
    PALPATE_WORKERS      --workers

An option overrides the environment; --scheduler and --workers count as one option. The command
line is remembered, so a command that Ctrl-C stops can say how to continue it.

`palpate --help` loads this module, so it imports neither NumPy nor rich.
"""

import logging
import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import typer
from typer.core import TyperGroup

from palpate.service.cluster.cluster_choice import Workers, host_and_port, read_workers
from palpate.service.errors_and_interrupts import Interrupted, stop_requests
from palpate.storage.backends.store_paths import Place, place_of
from palpate.storage.errors import InputError

_PACKAGE = "palpate.service.commands"


@dataclass(frozen=True, slots=True)
class LazyCommand:
    """A command, or a group of commands, that has not been imported.

    Parameters
    ----------
    place : str
        Module below `service.commands` and name of the function or `typer.Typer` in it,
        as in ``studies.run:run``.
    summary : str
        First sentence of its help.
    """

    place: str
    summary: str

    def load(self, name: str) -> Any:
        """Import the module and return the Click command."""
        module, _, attribute = self.place.partition(":")
        found = getattr(import_module(f"{_PACKAGE}.{module}"), attribute)
        app = typer.Typer(add_completion=False, rich_markup_mode=None)
        if isinstance(found, typer.Typer):
            app.add_typer(found, name=name)
        else:
            app.command(name)(found)
        return typer.main.get_group(app).commands[name]


def lazy_group(commands: Mapping[str, LazyCommand]) -> type[TyperGroup]:
    """Return a group that lists commands by summary and loads only the one used."""

    class LazyGroup(TyperGroup):
        def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
            """Replace the placeholder with the command; also used by shell completion."""
            name, listed, rest = super().resolve_command(ctx, args)
            return name, commands[name].load(name) if name else listed, rest

    return LazyGroup


def list_commands(app: typer.Typer, commands: Mapping[str, LazyCommand]) -> None:
    """Add the names and summaries of commands to an application."""
    for name, command in commands.items():
        app.command(name, help=command.summary)(_listed)


def _listed() -> None:
    """Do nothing; a placeholder for a command in the list, never run."""


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


STORE, SCHEDULER, WORKERS = "PALPATE_STORE", "PALPATE_SCHEDULER", "PALPATE_WORKERS"
RUNS = Path("runs")

_arguments: ContextVar[tuple[str, ...]] = ContextVar("arguments of the command", default=())


def remember_command(arguments: Sequence[str]) -> None:
    """Store the command line for `this_command`."""
    _arguments.set(tuple(arguments))


def this_command() -> str:
    """Return the running command in a form that can be pasted into a shell."""
    return shlex.join(["palpate", *_arguments.get()])


def stated_store(option: str | None) -> Place | None:
    """Return the store given as an option or in the environment, or None.

    Raises
    ------
    StoreError
        If it is a URL of an unsupported kind.
    """
    given = option or os.environ.get(STORE)
    return place_of(given) if given else None


def store_place(option: str | None) -> Place:
    """Return the store to use: the one given, else runs/store.

    Raises
    ------
    StoreError
        If it is a URL of an unsupported kind.
    """
    return stated_store(option) or place_of(RUNS / "store")


def cluster_options(
    scheduler: str | None, workers: str | None
) -> tuple[str | None, Workers | None]:
    """Return the scheduler or the number of workers; both None by default.

    Raises
    ------
    InputError
        If both are given, or `workers` is not a number or range, or too small.
    ClusterError
        If the scheduler's address is not valid.
    """
    option = "--workers "
    if scheduler is None and workers is None:
        scheduler = os.environ.get(SCHEDULER) or None
        workers, option = None if scheduler else os.environ.get(WORKERS) or None, f"{WORKERS}="
    elif scheduler is not None and workers is not None:
        raise InputError(
            "--workers starts processes on this machine; --scheduler uses a running cluster with "
            "its own workers: give one of them."
        )
    if scheduler is not None:
        host_and_port(scheduler)
    return scheduler, None if workers is None else read_workers(workers, option)


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
