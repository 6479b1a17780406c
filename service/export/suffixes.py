"""The suffixes of what can be written, and the refusal of others."""

from pathlib import Path

from palpate.storage.errors import InputError
from palpate.workers.plugins import plugins

VOLUME_SUFFIXES = (".nrrd",)
MESH_SUFFIXES = (".vtu", ".vtk", ".msh")


def solved_suffixes() -> tuple[str, ...]:
    """Return the suffixes of the files that a solved body can be written to."""
    return tuple(f".{name}" for name in plugins("exporters"))


def check_suffix(path: Path | None, known: tuple[str, ...], option: str = "--out ") -> None:
    """Refuse a file that could not be written, before anything is computed for it.

    Raises
    ------
    InputError
        If its suffix is none of `known`, or its folder is missing.
    """
    if path is None:
        return
    if path.suffix.lower() not in known:
        suffix = path.suffix or "no suffix"
        raise InputError(f"{option}{path}: {suffix} is not known, use one of {', '.join(known)}.")
    if not path.parent.is_dir():
        raise InputError(f"{option}{path}: the folder {path.parent} does not exist, make it first.")
    if path.is_dir():
        raise InputError(f"{option}{path} is a folder: give the name of a file.")
