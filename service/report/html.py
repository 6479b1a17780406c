"""Writes the page: one file, which needs no other."""

from pathlib import Path

from service.report.context import context
from service.report.evidence import Evidence, gather
from service.report.template import filled
from storage.atomic import write_file
from storage.layout import StudyLayout


def write_report(study_dir: Path) -> Path:
    """Write ``report.html`` into the folder of a study, finished or not.

    Parameters
    ----------
    study_dir : Path
        Folder of the study. Its store is only read; what it has lost is said in words.

    Returns
    -------
    Path
        The file, which replaces an older one only when it is complete.

    Raises
    ------
    InputError
        If there is no study in that folder.
    StoreError
        If its journal is damaged, or the report cannot be written.
    """
    page = render(gather(study_dir))
    path = StudyLayout(study_dir).report
    write_file(path, page.encode())
    return path


def render(evidence: Evidence) -> str:
    """The page as text; equal evidence gives the same bytes."""
    return filled("report.html.j2", context(evidence))
