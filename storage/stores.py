"""Opens a store: one folder that workers and driver share.

Volumes, meshes, fields and finished evaluations lie there by digest, so
any study that asks for the same thing finds it. Nothing in a store is changed
once written; everything can be made again.
"""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from storage.atomic import clean_leftovers, explained, write_file
from storage.errors import NewerSchemaError, StoreError
from storage.layout import StoreLayout
from storage.plain import dumps, loads

SCHEMA_VERSION = 1

# A Path made of a URL has lost one of its slashes.
_URL = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]+):/")


@dataclass(frozen=True, slots=True)
class Store:
    """An opened store.

    Parameters
    ----------
    root : Path
        Its folder, absolute.
    """

    root: Path

    @property
    def layout(self) -> StoreLayout:
        """Return the paths of the store."""
        return StoreLayout(self.root)

    def __str__(self) -> str:
        return str(self.root)


def open_store(location: str | Path, *, create: bool = True) -> Store:
    """Open a store, or make one.

    Parameters
    ----------
    location : str or Path
        A folder; ``~`` is the user's home.
    create : bool
        Make the store if it is not there, and be ready to write. Without it the
        store must exist and may be read-only.

    Raises
    ------
    StoreError
        If the location is a URL, is missing, cannot be written or is no store.
    NewerSchemaError
        If a newer version of Palpate made the store.
    """
    url = _URL.match(str(location))
    if url:
        raise StoreError(
            f"{location} is a URL ({url['scheme']}), but this version keeps stores in local "
            "folders only. Give a folder that all workers can reach, such as /data/palpate."
        )
    root = Path(location).expanduser().absolute()
    layout = StoreLayout(root)
    if create:
        _make(layout)
    _check(layout)
    if _writable(root):
        for folder in (root, *layout.folders):
            clean_leftovers(folder)
    return Store(root)


def _make(layout: StoreLayout) -> None:
    if layout.root.exists() and not layout.root.is_dir():
        raise StoreError(f"{layout.root} is a file, expected a folder. Choose another store.")
    with explained(layout.root):
        layout.root.mkdir(parents=True, exist_ok=True)
        if layout.marker.exists():
            _check(layout)  # a newer store is left as it is
        for folder in layout.folders:
            folder.mkdir(exist_ok=True)
    for folder in (layout.root, *layout.folders):
        if not _writable(folder):
            raise StoreError(
                f"{folder} cannot be written by you. Choose another store or change its "
                "permissions."
            )
    if not layout.marker.exists():
        about = "A store of Palpate: volumes, meshes and evaluations by digest."
        text = dumps({"schema_version": SCHEMA_VERSION, "about": about})
        write_file(layout.marker, text.encode() + b"\n")


def _writable(folder: Path) -> bool:
    effective = os.access in os.supports_effective_ids
    return os.access(folder, os.W_OK | os.X_OK, effective_ids=effective)


def _check(layout: StoreLayout) -> None:
    try:
        version = loads(layout.marker.read_bytes())["schema_version"]
        check_schema(version, SCHEMA_VERSION, layout.root)
    except FileNotFoundError as error:
        problem = "has no palpate-store.json" if layout.root.is_dir() else "is missing"
        raise StoreError(
            f"{layout.root} is not a store: it {problem}. Give the store of an earlier run, or "
            "run a study to make one."
        ) from error
    except OSError as error:
        raise StoreError(
            f"{layout.marker} cannot be read: {error.strerror or error}. Check the path and its "
            "permissions."
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(
            f"{layout.marker} is damaged ({error}). Remove that file and run the study again: "
            "what the store holds is found again."
        ) from error


def check_schema(version: Any, known: int, where: object) -> None:
    """Refuse what a newer version of Palpate has written.

    Raises
    ------
    NewerSchemaError
        If `version` is above `known`.
    ValueError
        If `version` is no version number.
    """
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise ValueError(f"schema_version is {version!r}, expected a whole number from 1")
    if version > known:
        raise NewerSchemaError(
            f"{where} was written by a newer version of Palpate (schema {version}; this version "
            f"reads up to {known}). Upgrade with `pip install --upgrade palpate`."
        )
