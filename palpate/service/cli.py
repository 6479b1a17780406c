"""The command `palpate`.

Exit codes: 0 done; 1 an internal error, with its traceback; 2 an error that the user can
correct, with one message; 130 interrupted, with the command to continue; 141 the reader of the
output has closed it.
"""

import errno
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated

import typer

from palpate.service.commands.command_line import (
    LazyCommand,
    Level,
    lazy_group,
    list_commands,
    remember_command,
    set_verbosity,
)
from palpate.storage.errors import PalpateError

USERS_FAULT = 2
NO_READER = 141
# System errors that the user can correct.
REFUSALS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "permission is denied",
    errno.EPERM: "permission is denied",
    errno.ENAMETOOLONG: "the name is too long",
    errno.ENOTDIR: "part of the path is a file",
    errno.EISDIR: "it is a folder",
    errno.ELOOP: "symbolic links form a loop",
    errno.EMFILE: "too many files are open",
    errno.EIO: "the disk reports an error",
}

# The module of a command is imported when it is run; tests compare the summaries with its help.
COMMANDS = {
    "new": LazyCommand(
        "studies.new:new", "Write a commented file for a study, diagnosis or experiment."
    ),
    "run": LazyCommand("studies.run:run", "Run a study, or continue one where it stopped."),
    "status": LazyCommand(
        "studies.status:status", "Show a study's progress, even while it is running."
    ),
    "show": LazyCommand("studies.show:show", "Show a candidate's parameters, score and outcome."),
    "report": LazyCommand(
        "studies.report:report", "Print a study's results and write report.html to its folder."
    ),
    "compare": LazyCommand(
        "studies.compare:compare", "Compare the results and settings of several studies."
    ),
    "evaluate": LazyCommand(
        "studies.evaluate:evaluate", "Evaluate a table or a design of candidates for a study."
    ),
    "profile": LazyCommand(
        "studies.profile:profile", "Show how well the image is fitted as one constant varies."
    ),
    "open": LazyCommand(
        "studies.open_:open_", "Open a study's page in the browser and print its path."
    ),
    "diagnose": LazyCommand(
        "studies.diagnose:diagnose", "Find where and why a simulation differs from the real body."
    ),
    "plan": LazyCommand(
        "studies.plan:plan", "Predict which causes of a gap the scans could reveal."
    ),
    "import": LazyCommand(
        "images.import_:import_image", "Import a labelled image and show how it was read."
    ),
    "phantom": LazyCommand(
        "images.phantom:phantom", "Generate a virtual breast and save it in the store."
    ),
    "mesh": LazyCommand(
        "images.mesh:mesh", "Mesh the body of a study and print the mesh properties."
    ),
    "parameters": LazyCommand(
        "studies.parameters:parameters", "List an organ's constants and effects for study files."
    ),
    "schema": LazyCommand(
        "studies.schema:schema", "Print the keys of a file, with their meanings, as JSON schema."
    ),
    "fit-law": LazyCommand(
        "studies.fit_law:fit_law", "Fit material laws to stress-stretch tables of one material."
    ),
    "simulate": LazyCommand("studies.simulate:simulate", "Compress the body of a study once."),
    "export": LazyCommand(
        "studies.export:export", "Export a deformed body to ParaView, CAD or another solver."
    ),
    "serve": LazyCommand("machines.serve:serve", "Serve studies and diagnoses over HTTP."),
    "cluster": LazyCommand(
        "machines.cluster:cluster", "Start workers as jobs of SLURM, PBS, LSF or SGE."
    ),
    "certs": LazyCommand("machines.certs:certs", "Create TLS certificates for a Dask cluster."),
    "thesis": LazyCommand(
        "validation.thesis:thesis", "Run the thesis' experiments and check its published values."
    ),
    "mammogram": LazyCommand(
        "images.mammogram:mammogram", "Simulate CC and MLO mammograms of a study's fitted body."
    ),
    "doctor": LazyCommand("machines.doctor:doctor", "Check that everything is ready for a run."),
    "bench": LazyCommand(
        "validation.bench:bench", "Measure the time and memory of each stage of a simulation."
    ),
    "strategies": LazyCommand(
        "validation.strategies:strategies",
        "Compare the cost of search strategies on the same targets.",
    ),
    "blind": LazyCommand(
        "validation.blind:app", "Test the diagnosis on cases whose true causes are sealed."
    ),
    "token": LazyCommand("machines.token:app", "Manage the access tokens of a service."),
    "store": LazyCommand(
        "machines.store:app", "Maintain a store: check it, free space, move studies."
    ),
}

app = typer.Typer(
    name="palpate",
    cls=lazy_group(COMMANDS),
    help="Estimate the stiffness of living tissue from images, by finite elements and search.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(requested: bool) -> None:
    if requested:
        # Loads numpy, which `palpate --help` does without.
        from palpate.service.installed_packages import palpate_version

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
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show only results, warnings and errors.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Show log messages: --log-level info.")
    ] = False,
    log_level: Annotated[
        Level | None,
        typer.Option(help="Show log messages of this level and above.", show_default=False),
    ] = None,
) -> None:
    set_verbosity(quiet=quiet, level=log_level or ("info" if verbose else None))


list_commands(app, COMMANDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
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
    except SystemExit as ended:  # typer exits like this: 2 for a wrong option, 130 for Ctrl-C
        if isinstance(getattr(ended.__context__, "__cause__", None), KeyboardInterrupt):
            typer.echo("Interrupted.", err=True)  # before a command could print how to continue
        # typer exits with 1 if the output is closed.
        return NO_READER if ended.code == 1 else int(ended.code or 0)
    except MemoryError:
        return _explain("this machine has too little memory: use a coarser mesh or larger voxels.")
    except OSError as error:
        if error.errno not in REFUSALS:
            raise
        where = error.filename or "standard output"
        return _explain(f"{where}: {_why(error)}. Correct this, or choose another place.")
    except Exception:
        # Imported here, and the libraries with it, because `palpate --help` does without.
        from palpate.service.library_settings import unusable_settings

        reasons = list(unusable_settings())
        if not reasons:
            raise
        return _explain("\n".join(reasons))
    return 0


def _explain(message: str) -> int:
    with suppress(OSError):
        typer.echo(f"Error: {message}", err=True)
    return USERS_FAULT


def _why(error: OSError) -> str:
    return REFUSALS.get(error.errno or 0, error.strerror or str(error))


def _accept_any_character() -> None:
    """Print a question mark for characters that a terminal cannot show."""
    for stream in (sys.stdout, sys.stderr):
        if (getattr(stream, "encoding", "") or "").lower().replace("-", "") != "utf8":
            with suppress(AttributeError, ValueError, OSError):
                stream.reconfigure(errors="replace")  # type: ignore[union-attr]


def _leave_standard_output() -> None:
    """Keep Python from flushing the unwritable output again at exit."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
