"""Defines the command `palpate`.

Exit codes: 0 done; 1 a fault of ours, with its traceback; 2 something that the
user can put right, said in one message; 130 interrupted, and how to go on; 141 nobody
reads the output any more.
"""

import errno
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated

import typer

from palpate.service.commands import open_
from palpate.service.commands.diagnoses import diagnose, plan
from palpate.service.commands.images import import_, import_case, mammogram, mesh, phantom
from palpate.service.commands.machines import certs, doctor, serve, slurm, store, token
from palpate.service.commands.settings import remember_command
from palpate.service.commands.studies import (
    export,
    new,
    parameters,
    profile,
    report,
    run,
    show,
    simulate,
    status,
    strategies,
)
from palpate.service.commands.validation import bench, blind, thesis
from palpate.storage.errors import PalpateError

USERS_FAULT = 2
NO_READER = 141
# What the system refuses for reasons that the user can put right.
REFUSALS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "permission is denied",
    errno.EPERM: "permission is denied",
    errno.ENAMETOOLONG: "the name is too long",
    errno.ENOTDIR: "a part of the path is a file",
    errno.EISDIR: "it is a folder",
    errno.ELOOP: "symbolic links lead in a circle",
    errno.EMFILE: "too many files are open",
    errno.EIO: "the disk reports an error",
}

app = typer.Typer(
    name="palpate",
    help="Estimate the stiffness of living tissue from images, by finite elements and search.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(requested: bool) -> None:
    if requested:
        from palpate.service.versions import palpate_version

        typer.echo(f"palpate {palpate_version()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    pass


app.command("new")(new.new)
app.command("run")(run.run)
app.command("status")(status.status)
app.command("show")(show.show)
app.command("report")(report.report)
app.command("profile")(profile.profile)
app.command("open")(open_.open_)
app.command("diagnose")(diagnose.diagnose)
app.command("plan")(plan.plan)
app.add_typer(blind.app, name="blind")
app.command("import")(import_.import_image)
app.command("import-case")(import_case.import_case)
app.command("phantom")(phantom.phantom)
app.command("mesh")(mesh.mesh)
app.command("parameters")(parameters.parameters)
app.command("simulate")(simulate.simulate)
app.command("export")(export.export)
app.command("serve")(serve.serve)
app.command("slurm")(slurm.slurm)
app.add_typer(token.app, name="token")
app.add_typer(store.app, name="store")
app.command("certs")(certs.certs)
app.command("thesis")(thesis.thesis)
app.command("mammogram")(mammogram.mammogram)
app.command("doctor")(doctor.doctor)
app.command("bench")(bench.bench)
app.command("strategies")(strategies.strategies)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; its exit code."""
    typed = list(sys.argv[1:] if arguments is None else arguments)
    remember_command(typed)
    _accept_any_character()
    code = _run(typed)
    try:
        sys.stdout.flush()
    except OSError as error:
        _leave_standard_output()
        if isinstance(error, BrokenPipeError):
            return NO_READER
        return _explain(f"standard output cannot be written: {_why(error)}")
    return code


def _run(typed: list[str]) -> int:
    try:
        app(typed, prog_name="palpate")
    except PalpateError as error:
        return _explain(str(error))
    except SystemExit as ended:  # typer leaves so, with 2 for a wrong option and 130 for Ctrl-C
        if isinstance(getattr(ended.__context__, "__cause__", None), KeyboardInterrupt):
            typer.echo("Interrupted.", err=True)  # before a command could say how to go on
        # It leaves with 1 where nobody reads what is printed.
        return NO_READER if ended.code == 1 else int(ended.code or 0)
    except MemoryError:
        return _explain("the memory of this machine does not suffice: ask for fewer or coarser.")
    except OSError as error:
        if error.errno not in REFUSALS:
            raise
        where = error.filename or "standard output"
        return _explain(f"{where}: {_why(error)}. Put that right, or choose another place.")
    return 0


def _explain(message: str) -> int:
    with suppress(OSError):
        typer.echo(f"Error: {message}", err=True)
    return USERS_FAULT


def _why(error: OSError) -> str:
    return REFUSALS.get(error.errno or 0, error.strerror or str(error))


def _accept_any_character() -> None:
    """Print a question mark where a terminal does not know a character."""
    for stream in (sys.stdout, sys.stderr):
        if (getattr(stream, "encoding", "") or "").lower().replace("-", "") != "utf8":
            with suppress(AttributeError, ValueError, OSError):
                stream.reconfigure(errors="replace")  # type: ignore[union-attr]


def _leave_standard_output() -> None:
    """Keep Python from writing once more, when it ends, what could not be written."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
