"""`palpate run` starts a study, or continues it."""

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
    with stop_requests() as requests:  # before the imports, which take a while
        from rich.console import Console

        from service.progress import progress_observer
        from service.report.live import LivePage
        from service.study import Study

        spec = load_spec(study)
        home = folder or (study if study.is_dir() else RUNS / spec.name)
        progress = progress_observer(Console(stderr=as_json, highlight=False))
        opened = Study(spec, home, store, observers=[progress], accept_new_code=accept_new_code)
        if opened.ended:
            typer.echo(f"{home} is complete: nothing to run.", err=True)
        else:
            page = LivePage(home)
            opened.hooks.add(page)
            typer.echo(f"page: {page.path}, written after every generation", err=True)
            with page, progress:
                completed = _completed(opened, scheduler, workers, requests)
            _write_page(home, quick=not completed)
            if not completed:
                again = f"palpate run {study}" + (f" --study {folder}" if folder else "")
                typer.echo(f"Interrupted; what is finished is kept. To continue: {again}", err=True)
                raise typer.Exit(INTERRUPTED)
    _print(home, as_json)


def _write_page(home: Path, *, quick: bool) -> None:
    """Write the page at the end of a run; what hinders it is no fault of the search."""
    from service.report.study_page import write_report
    from storage.errors import PalpateError

    try:
        typer.echo(f"page: {write_report(home, quick=quick)}", err=True)
    except PalpateError as error:
        typer.echo(f"The page was not written. {error}", err=True)


def _print(home: Path, as_json: bool) -> None:
    from service.commands.report import print_report
    from service.commands.tables import make_console
    from service.results import study_results
    from service.results_json import study_json

    results = study_results(home)
    if as_json:
        print_json(study_json(results))
    else:
        print_report(results, make_console())


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
