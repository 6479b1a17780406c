"""What a path on disk is to a diagnosis."""

from pathlib import Path

from storage.errors import InputError
from workers.cases.imaged import ImagedSource
from workers.cases.source import Source
from workers.specimen.source import SpecimenSource
from workers.studies import is_study, open_study


def open_source(path: Path) -> Source:
    """The source that lies there.

    Parameters
    ----------
    path : Path
        A folder with case.json and its scans, or the folder of a study that has run.

    Raises
    ------
    InputError
        If it is nothing that can be diagnosed.
    """
    if (path / "case.json").is_file():
        return ImagedSource(path)
    if is_study(path):
        return open_study(path)
    if path.suffix in (".yaml", ".yml") and path.is_file():
        return SpecimenSource(path)
    raise InputError(
        f"{path} cannot be diagnosed: expected a folder with case.json and its scans, or the "
        "folder of a study that `palpate run` has made."
    )
