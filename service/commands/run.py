"""`palpate run`: start a study, or go on with it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.commands.common import (
    RUNS,
    JsonOption,
    SchedulerOption,
    WorkersOption,
    load_spec,
    print_json,
)
from service.commands.interrupts import INTERRUPTED, stop_requests

if TYPE_CHECKING:
    from service.study import Study


def run(
    study: Annotated[Path, typer.Argument(help="A study file, or a study's folder.")],
    folder: Annotated[
        Path | None,
        typer.Option("--study", help="The study's folder. Default: runs/NAME.", show_default=False),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: Annotated[
        Path | None,
        typer.Option(
            help="Folder of volumes and evaluations, seen by all workers. Default: that of the "
            "last run, else the folder store beside the study's.",
            show_default=False,
        ),
    ] = None,
    accept_new_code: Annotated[
        bool, typer.Option(help="Continue although the code has changed since the last run.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a study, or continue it: an existing study goes on where it was.

    Ctrl-C stops it at any time; the same command continues it.
    """
    with stop_requests() as requests:
        code = _run(study, folder, workers, scheduler, store, accept_new_code, as_json, requests)
    if code == INTERRUPTED:
        again = f"palpate run {study}" + (f" --study {folder}" if folder else "")
        typer.echo(f"Interrupted; what is finished is kept. To continue: {again}", err=True)
        raise typer.Exit(code)


def _run(
    study: Path, folder: Path | None, workers: int | None, scheduler: str | None,
    store: Path | None, accept_new_code: bool, as_json: bool, requests: list[int],
) -> int:  # fmt: skip
    from rich.console import Console

    from service.progress import progress_observer
    from service.results import study_results
    from service.study import Study

    spec = load_spec(study)
    home = folder or (study if study.is_dir() else RUNS / spec.name)
    progress = progress_observer(Console(stderr=as_json, highlight=False))
    made = Study(spec, home, store, observers=[progress], accept_new_code=accept_new_code)
    if made.ended:
        typer.echo(f"{home} is complete: nothing to run.", err=True)
    else:
        with progress:
            if not _completed(made, scheduler, workers, requests):
                return INTERRUPTED
    found = study_results(home)
    if as_json:
        print_json(found)
    else:
        from service.commands.report import print_report

        print_report(found, Console(highlight=False))
    return 0


def _completed(
    study: "Study", scheduler: str | None, workers: int | None, requests: list[int]
) -> bool:
    """Run to the end; False if somebody asked to stop."""
    from service.cluster import open_cluster
    from service.dispatch import Dispatcher
    from service.errors import Interrupted

    try:
        if requests:
            return False
        with open_cluster(scheduler, workers) as cluster:
            dispatcher = Dispatcher(cluster.client, stop=lambda: bool(requests))
            study.run(dispatcher, cluster.dashboard)
    except (Interrupted, KeyboardInterrupt):
        return False
    return True
