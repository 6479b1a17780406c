"""Summaries of a case, an experiment or a study, printed before anything runs."""

from pathlib import Path

from rich.console import Console

from palpate.service.commands.tables import print_table, progress_console
from palpate.service.study.spec import StudySpec
from palpate.workers.tasks.sources import understood


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
    rows = spec.case.understood([parameter["name"] for parameter in spec.free_parameters])
    if rows:
        print_table(console, None, rows, title="Understood:")


def folder_name(source: Path) -> str:
    """Return the name of the folder in runs/ for the source at a path."""
    path = source.absolute()
    if not path.is_file():
        return path.name
    return path.parent.name if path.stem == "case" else path.stem
