"""Suffixes of the supported formats, and the check of a file name."""

from pathlib import Path

from palpate.storage.errors import InputError
from palpate.workers.plugins import plugins

NIFTI_SUFFIXES = (".nii", ".nii.gz")
VOLUME_SUFFIXES = (".nrrd", *NIFTI_SUFFIXES)
MESH_SUFFIXES = (".vtu", ".vtk", ".msh")


def solved_suffixes() -> tuple[str, ...]:
    """Return the suffixes to which a solved body can be exported."""
    return tuple(f".{name}" for name in plugins("exporters"))


def suffix_of(path: Path, known: tuple[str, ...]) -> str:
    """Return the longest known suffix of a name, else its own suffix.

    Examples
    --------
    >>> suffix_of(Path("Body.NII.GZ"), VOLUME_SUFFIXES)
    '.nii.gz'
    >>> suffix_of(Path("body.seg.nrrd"), VOLUME_SUFFIXES)
    '.nrrd'
    """
    fitting = [suffix for suffix in known if path.name.lower().endswith(suffix)]
    return max(fitting, key=len, default=path.suffix.lower())


def check_suffix(path: Path | None, known: tuple[str, ...], option: str = "--out ") -> None:
    """Reject an unsupported file name before anything is computed.

    Raises
    ------
    InputError
        If the suffix is not in `known`, or the folder is missing.
    """
    if path is None:
        return
    suffix = suffix_of(path, known)
    if suffix not in known:
        raise InputError(
            f"{option}{path}: {suffix or 'no suffix'} is not supported; use one of "
            f"{', '.join(known)}."
        )
    if not path.parent.is_dir():
        raise InputError(f"{option}{path}: the folder {path.parent} does not exist; create it.")
    if path.is_dir():
        raise InputError(f"{option}{path} is a folder: give the name of a file.")
