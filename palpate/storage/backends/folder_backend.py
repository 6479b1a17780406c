"""Storage backend for a local folder; see `storage.backends.store_paths.Backend`."""

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zarr

from palpate.storage.backends.atomic_files import (
    clean_leftovers,
    explained,
    is_temporary,
    publishing,
    sync,
    withdraw,
    write_file,
)
from palpate.storage.backends.store_paths import DESCRIPTION, Entry, FillGroup, ZarrAddress
from palpate.storage.errors import StoreError


def read(place: Path) -> bytes:
    """Return the content of a file."""
    try:
        return place.read_bytes()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise FileNotFoundError(place) from error
    except OSError as error:
        raise StoreError(
            f"{place} cannot be read: {error.strerror or error}. Check the path and its "
            "permissions."
        ) from error


def write(place: Path, data: bytes) -> None:
    """Write a whole file or nothing."""
    write_file(place, data)


def create(place: Path, data: bytes) -> bool:
    """Write a new file; its name is created in one step."""
    with explained(place):
        place.parent.mkdir(exist_ok=True)
        try:
            with place.open("xb") as file:
                file.write(data)
        except FileExistsError:
            return False
        sync(place)
        sync(place.parent)
    return True


def is_file(place: Path) -> bool:
    """Return True if the file exists."""
    return place.is_file()


def entries(folder: Path) -> list[Entry[Path]]:
    """Return the entries of a folder."""
    found = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        try:
            found.append(Entry(path, path.stat().st_mtime, is_temporary(path)))
        except FileNotFoundError:  # its writer has just finished
            continue
    return found


def size_bytes(place: Path) -> int:
    """Return the size of a file, or of all files of a group."""
    if place.is_file():
        return place.stat().st_size
    return sum(file.stat().st_size for file in place.rglob("*") if file.is_file())


def remove(place: Path) -> bool:
    """Remove a file or a group, its name first."""
    return withdraw(place)


def move(place: Path, target: Path) -> None:
    """Rename a file or a group."""
    with explained(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        place.rename(target)


def publish_group(place: Path, attributes: Mapping[str, Any], fill: FillGroup) -> None:
    """Write a group under a temporary name and rename it."""
    # A folder without its description would block its name for ever. `place` is checked first: a
    # group that another writer publishes meanwhile has its description from the start.
    if place.exists() and not is_file(place / DESCRIPTION):
        withdraw(place)
    with explained(place), publishing(place) as temporary:
        fill(zarr.create_group(temporary, zarr_format=3, attributes=dict(attributes)))


@contextmanager
def zarr_group(place: Path) -> Iterator[ZarrAddress]:
    """Yield the folder of a group."""
    yield ZarrAddress(place, "")


def prepare(root: Path, folders: Sequence[Path]) -> None:
    """Make the folders of a store; raise an error if they are not writable."""
    if root.exists() and not root.is_dir():
        raise StoreError(f"{root} is a file, expected a folder. Choose another store.")
    with explained(root):
        root.mkdir(parents=True, exist_ok=True)
        for folder in folders:
            folder.mkdir(exist_ok=True)
    for folder in (root, *folders):
        if not _writable(folder):
            raise StoreError(
                f"You cannot write to {folder}. Choose another store or change its permissions."
            )


def why_no_store(root: Path) -> str:
    """Return the reason why the folder is not a store."""
    return "has no palpate-store.json" if root.is_dir() else "is missing"


def clean(root: Path, folders: Sequence[Path]) -> None:
    """Remove temporary names that are too old to be in use."""
    if _writable(root):
        for folder in (root, *folders):
            clean_leftovers(folder)


def free_bytes(root: Path) -> int | None:
    """Return the free space of the file system."""
    return shutil.disk_usage(root).free


def _writable(folder: Path) -> bool:
    effective = os.access in os.supports_effective_ids
    return os.access(folder, os.W_OK | os.X_OK, effective_ids=effective)
