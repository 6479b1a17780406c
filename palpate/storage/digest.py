"""Short names derived from content.

A digest is the first 16 hexadecimal digits of SHA-256: among a million names, two are equal
with a probability of 3e-8. Equal content has an equal digest in any process, on any machine
and in any order of keys; floats differ if any bit differs.
"""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.plain import to_plain

LENGTH = 16


def digest(*parts: Any) -> str:
    """Return the digest of plain values.

    Parameters
    ----------
    *parts : JSON-able
        Mappings, sequences, numbers and text; keys may be integers. ``1`` and ``1.0``
        differ, ``{1: "a"}`` and ``{"1": "a"}`` do not.

    Raises
    ------
    InputError
        If a number is NaN or infinite.
    TypeError
        If a part cannot be written as JSON.

    Examples
    --------
    >>> digest({"E_fat": 0.01, "nodes": 2000}) == digest({"nodes": 2000, "E_fat": 0.01})
    True
    """
    plain = to_plain(parts, finite=True, where="digest")
    # json writes floats by repr, the shortest text that restores the same bits.
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("ascii")).hexdigest()[:LENGTH]


def array_digest(array: NDArray[Any]) -> str:
    """Return the digest of an array's shape, type and values; its memory layout is ignored."""
    little = array.astype(array.dtype.newbyteorder("<"), order="C", copy=False)
    state = hashlib.sha256(f"{little.dtype.str}{little.shape}".encode())
    state.update(np.ascontiguousarray(little).data)
    return state.hexdigest()[:LENGTH]


def file_digest(path: Path | str) -> str:
    """Return the digest of a file's bytes, or of the names and bytes of all files in a folder.

    Hidden files are ignored.

    Raises
    ------
    InputError
        If the path is missing or cannot be read.
    """
    path = Path(path)
    try:
        if not path.is_dir():
            return _bytes_of(path)[:LENGTH]
        files = sorted(p.relative_to(path) for p in path.rglob("*") if p.is_file())
        shown = (p for p in files if not any(part.startswith(".") for part in p.parts))
        return digest([[p.as_posix(), _bytes_of(path / p)] for p in shown])
    except OSError as error:
        raise InputError(
            f"Cannot read {path}: {error.strerror or error}. Check the path and its permissions."
        ) from error


def source_digest(folders: Iterable[Path | str]) -> str:
    """Return the digest of all ``.py`` files in some packages.

    Parameters
    ----------
    folders : iterable of path
        Folders of packages, wherever they are installed.
    """
    listed = [
        [Path(folder).name, file.relative_to(folder).as_posix(), _bytes_of(file)]
        for folder in folders
        for file in Path(folder).rglob("*.py")
    ]
    return digest(sorted(listed))


def _bytes_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
