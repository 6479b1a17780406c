"""`palpate run` starts a study, or continues it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.service.commands.common import (
    AnywayOption,
    JsonOption,
    SchedulerOption,
    WorkersOption,
    load_spec,
    print_json,
)
from palpate.service.commands.echo import print_understood_study
from palpate.service.commands.interrupts import interruptible
from palpate.service.commands.settings import RUNS, cluster_options, stated_store

if TYPE_CHECKING:
    from palpate.service.report.study.live import LivePage
    from palpate.service.study.observers.progress import Progress


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
            metavar="FOLDER|s3://BUCKET/PREFIX",
            help="Store for volumes and evaluations, accessible to all workers. Default: "
            "$PALPATE_STORE, else the store of the last run, else the folder store next to the "
            "study's folder.",
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
    with interruptible():  # before the imports, which take a while
        scheduler, processes = cluster_options(scheduler, workers)
        spec = load_spec(study)  # a slip is named before what takes a while is imported
        home = folder or (study if study.is_dir() else RUNS / spec.name)
        from palpate.service.commands.tables import make_console
        from palpate.service.report.study.live import LivePage
        from palpate.service.run_study import Entrance, run_study
        from palpate.service.study.loop import Study
        from palpate.service.study.observers.progress import progress_observer
        from palpate.service.study.session import session

        progress, page = progress_observer(make_console(stderr=as_json)), LivePage(home)
        opened = Study(
            spec,
            home,
            stated_store(store),
            observers=[progress, page],
            accept_new_code=accept_new_code,
        )
        if opened.ended:
            typer.echo(f"{home} is complete: nothing to run.", err=True)
        elif not opened.begun:
            print_understood_study(spec, make_console(stderr=True))
        entrance = Entrance(
            anyway=anyway or accept_implausible,
            elsewhere=scheduler is not None,
            warn=_warn,
            shown=_shown(progress, page),
            write_page=_write_page,
        )
        run_study(opened, session(scheduler, processes), entrance)
    _print(home, as_json)


def _warn(warning: str) -> None:
    typer.echo(f"Warning: {warning}", err=True)


@contextmanager
def _shown(progress: "Progress", page: "LivePage") -> Iterator[None]:
    """Show the progress, and keep the page of the running study up to date."""
    with page, progress:
        yield


def _write_page(home: Path, quick: bool) -> None:
    """Write the page at the end of a run; a failure is no failure of the search."""
    from palpate.service.report.study.page import write_report
    from palpate.storage.errors import PalpateError

    try:
        typer.echo(f"page: {write_report(home, quick=quick)}", err=True)
    except PalpateError as error:
        typer.echo(f"The page was not written. {error}", err=True)


def _print(home: Path, as_json: bool) -> None:
    from palpate.service.commands.studies.report import print_report
    from palpate.service.commands.tables import make_console
    from palpate.service.results.as_json import study_json
    from palpate.service.results.read import study_results

    results = study_results(home)
    if as_json:
        print_json(study_json(results))
        return
    print_report(results, make_console())
    typer.echo(f"next: {join(['palpate', 'open', str(home)])}")
