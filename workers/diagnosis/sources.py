"""What a path on disk is to a diagnosis."""

from pathlib import Path

from storage.errors import InputError
from workers.diagnosis.imaged import ImagedSource
from workers.diagnosis.source import Source


def open_source(path: Path) -> Source:
    """The source that lies there.

    Parameters
    ----------
    path : Path
        A folder with case.json and its scans.

    Raises
    ------
    InputError
        If it is nothing that can be diagnosed.
    """
    if (path / "case.json").is_file():
        return ImagedSource(path)
    raise InputError(f"{path} cannot be diagnosed: expected a folder with case.json and its scans.")
