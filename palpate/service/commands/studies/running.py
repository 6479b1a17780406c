"""The implementation of `palpate run`, and what is printed before any long command computes.

A case, an experiment or a study is summarised first, with its defaults, as it was understood;
`palpate diagnose` and `palpate plan` use the same summaries. This module is imported by the
command when it is run, because its imports take seconds.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shlex import join

import typer
from rich.console import Console

from palpate.service.cluster.cluster_choice import Workers
from palpate.service.commands.command_line import RUNS, note, stated_store
from palpate.service.commands.named_study import load_spec
from palpate.service.commands.shared_options import print_json
from palpate.service.commands.studies.report import print_report
from palpate.service.commands.terminal_tables import make_console, print_table, progress_console
from palpate.service.report.study.live_page import LivePage
from palpate.service.report.study.study_page import write_report
from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import study_results
from palpate.service.run_study import Entrance, run_study
from palpate.service.study.loop import Study
from palpate.service.study.study_keys import StudySpec
from palpate.service.study.study_progress import Progress, progress_observer
from palpate.service.study.study_session import session
from palpate.storage.errors import PalpateError
from palpate.workers.tasks.diagnosis_sources import understood


def print_understood(source: Path) -> None:
    """Print a table of a case or an experiment; nothing for a study.

    Raises
    ------
    InputError
        If the file is not valid.
    """
    rows = understood(source)
    if not rows:
        return
    print_table(progress_console(), None, rows, title="Understood:")


def print_understood_study(spec: StudySpec, console: Console) -> None:
    """Print the physics of a study, including defaults."""
    free = [parameter["name"] for parameter in spec.free_parameters]
    rows = [*spec.case.understood(free), *spec.target.understood]
    if rows:
        print_table(console, None, rows, title="Understood:")


def folder_name(source: Path) -> str:
    """Return the name of the folder in runs/ for the source at a path."""
    path = source.absolute()
    if not path.is_file():
        return path.name
    return path.parent.name if path.stem == "case" else path.stem


@dataclass(frozen=True)
class RunOptions:
    """The options of the command; see `palpate run --help`."""

    folder: Path | None
    store: str | None
    accept_new_code: bool
    anyway: bool
    as_json: bool


def run_and_print(
    study: Path, wanted: RunOptions, workers: Workers | None, scheduler: str | None
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
    _print_results(home, wanted.as_json)


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


def _print_results(home: Path, as_json: bool) -> None:
    results = study_results(home)
    if as_json:
        print_json(study_json(results))
        return
    print_report(results, make_console())
    typer.echo(f"next: {join(['palpate', 'open', str(home)])}")
