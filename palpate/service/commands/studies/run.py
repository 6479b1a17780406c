"""The command `palpate run`."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.service.commands.command_line import cluster_options, interruptible
from palpate.service.commands.shared_options import (
    AnywayOption,
    JsonOption,
    SchedulerOption,
    WorkersOption,
)


def run(
    study: Annotated[Path, typer.Argument(help="Study file or study folder.")],
    folder: Annotated[
        Path | None,
        typer.Option(
            "--study", help="Folder for the study. Default: runs/NAME.", show_default=False
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|URL",
            help="Store for volumes and evaluations, accessible to all workers: a folder, or "
            "s3://, gs:// or az://BUCKET/PREFIX. Default: $PALPATE_STORE, else the store of "
            "the last run, else the folder store next to the study's folder.",
            show_default=False,
        ),
    ] = None,
    accept_new_code: Annotated[
        bool, typer.Option(help="Continue even if the code has changed since the last run.")
    ] = False,
    anyway: AnywayOption = False,
    accept_implausible: Annotated[bool, typer.Option(hidden=True)] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a study, or continue one where it stopped.

    Press Ctrl-C to stop at any time; the same command continues the study. Events are logged in
    palpate.log in the study's folder.
    """
    with interruptible():
        scheduler, processes = cluster_options(scheduler, workers)
        # Imports take seconds; Ctrl-C must print how to continue even now.
        from palpate.service.commands.studies.running import RunOptions, run_and_print

        wanted = RunOptions(folder, store, accept_new_code, anyway or accept_implausible, as_json)
        run_and_print(study, wanted, processes, scheduler)
