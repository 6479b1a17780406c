"""The implementation of `palpate run`."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shlex import join

import typer

from palpate.service.cluster.worker_range import Workers
from palpate.service.commands.common import (
    print_json,
)
from palpate.service.commands.echo import print_understood_study
from palpate.service.commands.named_study import load_spec
from palpate.service.commands.settings import RUNS, stated_store
from palpate.service.commands.studies.report import print_report
from palpate.service.commands.tables import make_console, progress_console
from palpate.service.commands.verbosity import note
from palpate.service.report.study.live import LivePage
from palpate.service.report.study.page import write_report
from palpate.service.results.as_json import study_json
from palpate.service.results.read import study_results
from palpate.service.run_study import Entrance, run_study
from palpate.service.study.loop import Study
from palpate.service.study.observers.progress import Progress, progress_observer
from palpate.service.study.session import session
from palpate.storage.errors import PalpateError


@dataclass(frozen=True)
class Wanted:
    """The options of the command; see `palpate run --help`."""

    folder: Path | None
    store: str | None
    accept_new_code: bool
    anyway: bool
    as_json: bool


def run_and_print(
    study: Path, wanted: Wanted, workers: Workers | None, scheduler: str | None
) -> None:
    """Run a study to its end and print its results."""
    spec = load_spec(study)
    home = wanted.folder or (study if study.is_dir() else RUNS / spec.name)
    progress, page = progress_observer(progress_console(stderr=wanted.as_json)), LivePage(home)
    opened = Study(
        spec,
        home,
        stated_store(wanted.store),
        observers=[progress, page],
        accept_new_code=wanted.accept_new_code,
    )
    if opened.ended:
        note(f"{home} is complete: nothing to run.")
    elif not opened.begun:
        print_understood_study(spec, progress_console())
    entrance = Entrance(
        anyway=wanted.anyway,
        elsewhere=scheduler is not None,
        warn=_warn,
        shown=_shown(progress, page),
        write_page=_write_page,
    )
    run_study(opened, session(scheduler, workers), entrance)
    _print(home, wanted.as_json)


def _warn(warning: str) -> None:
    typer.echo(f"Warning: {warning}", err=True)


@contextmanager
def _shown(progress: Progress, page: LivePage) -> Iterator[None]:
    """Show the progress, and keep the live page up to date."""
    with page, progress:
        yield


def _write_page(home: Path, quick: bool) -> None:
    """Write the page at the end of a run; a failure does not affect the study."""
    try:
        note(f"page: {write_report(home, quick=quick)}")
    except PalpateError as error:
        typer.echo(f"The page was not written. {error}", err=True)


def _print(home: Path, as_json: bool) -> None:
    results = study_results(home)
    if as_json:
        print_json(study_json(results))
        return
    print_report(results, make_console())
    typer.echo(f"next: {join(['palpate', 'open', str(home)])}")
