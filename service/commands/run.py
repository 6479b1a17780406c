"""`palpate run` starts a study, or continues it."""

from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated

import typer

from service.commands.common import (
    AnywayOption,
    JsonOption,
    SchedulerOption,
    WorkersOption,
    load_spec,
    print_findings,
    print_json,
)
from service.commands.echo import print_understood_study
from service.commands.interrupts import interrupted, stop_requests
from service.commands.settings import RUNS, cluster_options, stated_store

if TYPE_CHECKING:
    from service.progress import Progress
    from service.study import Study
    from service.worker_range import Workers


def run(
    study: Annotated[Path, typer.Argument(help="A study file, or a study's folder.")],
    folder: Annotated[
        Path | None,
        typer.Option("--study", help="The study's folder. Default: runs/NAME.", show_default=False),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    store: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|s3://BUCKET/PREFIX",
            help="Store of volumes and evaluations, seen by all workers. Default: "
            "$PALPATE_STORE, else that of the last run, else the folder store beside the study's.",
            show_default=False,
        ),
    ] = None,
    accept_new_code: Annotated[
        bool, typer.Option(help="Continue although the code has changed since the last run.")
    ] = False,
    anyway: AnywayOption = False,
    accept_implausible: Annotated[bool, typer.Option(hidden=True)] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a study, or continue it: an existing study goes on where it was.

    Ctrl-C stops it at any time; the same command continues it. What happened when is in
    palpate.log in the study's folder.
    """
    with stop_requests() as requests:  # before the imports, which take a while
        scheduler, processes = cluster_options(scheduler, workers)
        spec = load_spec(study)  # a slip is named before what takes a while is imported
        home = folder or (study if study.is_dir() else RUNS / spec.name)
        from service.commands.tables import make_console
        from service.progress import progress_observer
        from service.report.live import LivePage
        from service.run_log import logging_to
        from service.study import Study
        from storage.layout import StudyLayout

        progress, page = progress_observer(make_console(stderr=as_json)), LivePage(home)
        completed = True
        with logging_to(StudyLayout(home).log) as log:
            opened = Study(
                spec,
                home,
                stated_store(store),
                observers=[progress, log, page],
                accept_new_code=accept_new_code,
            )
            if opened.ended:
                typer.echo(f"{home} is complete: nothing to run.", err=True)
            else:
                if not opened.begun:
                    _look_first(
                        opened, anyway or accept_implausible, elsewhere=scheduler is not None
                    )
                with page:
                    completed = _completed(opened, progress, scheduler, processes, requests)
                if page.path.parent.is_dir():
                    _write_page(home, quick=not completed)
                if not completed:
                    log.note("interrupted")
        if not completed:
            raise interrupted()
    _print(home, as_json)


def _look_first(study: "Study", anyway: bool, *, elsewhere: bool) -> None:
    """Refuse what cannot be meant, and print the physics and what is unusual."""
    from service.commands.tables import make_console
    from service.preflight import preflight
    from workers.organs.study_checks import caveats_of

    print_understood_study(study.spec, make_console(stderr=True))
    findings = preflight(study.spec, study.store, anyway=anyway, elsewhere=elsewhere)
    print_findings(findings)
    study.caveats = caveats_of(findings)


def _completed(
    study: "Study",
    progress: "Progress",
    scheduler: str | None,
    workers: "Workers | None",
    requests: list[int],
) -> bool:
    """Run to the end; False if somebody asked to stop."""
    from service.cluster import open_cluster
    from service.dask_records import DaskRecords
    from service.dispatch import Dispatcher
    from service.errors import GenerationCrashError, Interrupted

    try:
        if requests:
            return False
        with progress, open_cluster(scheduler, workers) as cluster:
            dispatcher = Dispatcher(cluster.client, stop=lambda: bool(requests))
            study.hooks.add(DaskRecords(cluster.client))
            study.run(dispatcher, cluster.dashboard)
    except (Interrupted, KeyboardInterrupt):
        return False
    except GenerationCrashError as error:
        log = study.folder.layout.log
        raise GenerationCrashError(f"{error} Its traceback is in {log}.", error.traceback) from None
    return True


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
    from service.results_json import study_json
    from service.results_reader import study_results

    results = study_results(home)
    if as_json:
        print_json(study_json(results))
        return
    print_report(results, make_console())
    typer.echo(f"next: {join(['palpate', 'open', str(home)])}")
