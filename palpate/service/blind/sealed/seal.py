"""Hashes that can be checked with ``sha256sum``.

::

    of a folder          sha256 of the output of `sha256sum *` in it (with LC_ALL=C)
    of a truth           sha256 of its salt, 32 random bytes, followed by the hash of its folder
                         as text

A salted hash reveals nothing about the truth before it is opened, although there are few enough
truths to try them one by one.
"""

import hashlib
import json
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palpate.storage.backends.atomic import write_file
from palpate.storage.errors import InputError
from palpate.storage.plain import to_plain
from palpate.workers.documents import parse_json

SALT_BYTES = 32


def new_salt() -> str:
    """Draw a salt in hexadecimal digits."""
    return secrets.token_hex(SALT_BYTES)


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(
            f"Cannot read {path}: {error.strerror or error}. A sealed set must be complete."
        ) from error


def folder_hash(folder: Path) -> str:
    """Return the SHA-256 of names and content of the files in a folder, except hidden ones.

    Raises
    ------
    InputError
        If the folder is missing or a file cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is missing. A sealed set must be complete.")
    names = sorted(p.name for p in folder.iterdir() if p.is_file() and p.name[0] != ".")
    lines = (f"{file_hash(folder / name)}  {name}\n" for name in names)
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def salted_hash(salt: str, folder: Path) -> str:
    """Return the sealed hash of a truth.

    Parameters
    ----------
    salt : str
        See `new_salt`.
    folder : Path
        Folder of the truth.
    """
    content = folder_hash(folder).encode()
    return hashlib.sha256(bytes.fromhex(salt) + content).hexdigest()


def write_json(path: Path, record: Mapping[str, Any]) -> str:
    """Write a record with sorted keys and return the hash of the file."""
    text = json.dumps(to_plain(record), indent=1, sort_keys=True, allow_nan=False)
    write_file(path, text.encode() + b"\n")
    return file_hash(path)


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON record.

    Raises
    ------
    InputError
        If it cannot be read, or is not a record.
    """
    try:
        record = parse_json(path.read_bytes(), str(path))
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror or error}.") from error
    if not isinstance(record, dict):
        raise InputError(
            f"{path} does not contain a record: found {type(record).__name__}, expected {{..}}."
        )
    return record
