"""The command `palpate open`."""

import os
import sys
import webbrowser
from pathlib import Path

import typer

from palpate.service.commands.named_study import find_study
from palpate.service.commands.shared_options import StudyArgument
from palpate.service.report.study.study_page import write_report
from palpate.storage.backends.store_paths import StudyLayout


def open_(study: StudyArgument = None) -> None:
    """Open a study's page in the browser and print its path.

    A page that is missing or older than the journal is written first. Also opens the page in the
    folder of a diagnosis or plan.
    """
    page = _page(find_study(study))
    typer.echo(f"page: {page}")
    if not _shown(page):
        typer.echo("No browser was found: open this file yourself.", err=True)


def _page(folder: Path) -> Path:
    """Return the up-to-date page of a folder, writing it if needed."""
    layout = StudyLayout(folder.absolute())
    for other in ("diagnosis.html", "plan.html"):
        if not layout.journal.is_file() and (layout.root / other).is_file():
            return layout.root / other
    if _is_newer(layout.report, layout.journal):
        return layout.report
    return write_report(layout.root)


def _is_newer(page: Path, journal: Path) -> bool:
    """Check whether a page is newer than the last line of a journal."""
    if not (page.is_file() and journal.is_file()):
        return False
    return page.stat().st_mtime_ns >= journal.stat().st_mtime_ns


def _shown(page: Path) -> bool:
    """Open the page in a browser; return False if there is none."""
    headless = sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or os.environ.get("BROWSER")
    )
    if headless:
        return False
    try:
        return webbrowser.open(page.as_uri())
    except webbrowser.Error:
        return False
