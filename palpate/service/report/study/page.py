"""The page of a study, in one self-contained file."""

from pathlib import Path

from palpate.service.report.page.template import filled
from palpate.service.report.study.context import context
from palpate.service.report.study.data import StudyData, read_study_data
from palpate.storage.backends.atomic import write_file
from palpate.storage.backends.layout import StudyLayout


def write_report(study_dir: Path, *, quick: bool = False) -> Path:
    """Write ``report.html`` into the folder of a study, finished or not.

    Parameters
    ----------
    study_dir : Path
        Folder of the study. Its store is only read; missing data are named on the page.
    quick : bool
        Skip slow parts; see `service.report.study.data.read_study_data`.

    Returns
    -------
    Path
        The file; an older one is replaced atomically.

    Raises
    ------
    InputError
        If there is no study in the folder.
    StoreError
        If its journal is damaged, or the report cannot be written.
    """
    page = render(read_study_data(study_dir, quick=quick))
    path = StudyLayout(study_dir).report
    write_file(path, page.encode())
    return path


def render(data: StudyData) -> str:
    """Return the page as text; equal data give the same bytes."""
    return filled("study.html.j2", context(data))
