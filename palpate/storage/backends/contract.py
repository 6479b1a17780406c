"""The interface of a storage backend; two modules implement it.

::

    palpate.storage.backends.local     a folder: temporary names, renamed when complete
    palpate.storage.backends.objects    a prefix in a bucket: conditional puts, descriptions last

An object with a name is complete, and if two writers use the same name, one of them wins: both
modules guarantee this, and `tests/storage/test_backends.py` tests both.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeAlias, TypeVar, cast

from palpate.storage.backends.places import Place

if TYPE_CHECKING:
    import zarr

P = TypeVar("P")
DESCRIPTION = "zarr.json"
ARRAYS_IN = "arrays_in"

FillGroup: TypeAlias = "Callable[[zarr.Group], None]"


@dataclass(frozen=True, slots=True)
class Entry(Generic[P]):
    """One entry in a folder of a store.

    Parameters
    ----------
    place : Path or ObjectPath
        A file, or a group of arrays.
    modified_s : float
        Time of the last write, in seconds since 1970.
    half_written : bool
        True if its writer has not finished, or never will; readers skip it.
    """

    place: P
    modified_s: float
    half_written: bool


@dataclass(frozen=True, slots=True)
class ZarrAddress:
    """Address of a group for Zarr.

    Parameters
    ----------
    store : path or zarr store
    path : str
        Inside the store; empty for its root.
    """

    store: Any
    path: str

    def inside(self, *names: str) -> str:
        """Return the path of a member of the group."""
        return "/".join(part for part in (self.path, *names) if part)


class Backend(Protocol[P]):
    """Reading and writing in one kind of place.

    All methods raise `StoreError` with advice if the place cannot be read or written.
    """

    def read(self, place: P) -> bytes:
        """Return the content of a file.

        Raises
        ------
        FileNotFoundError
            If it does not exist.
        """

    def write(self, place: P, data: bytes) -> None:
        """Write a whole file or nothing, replacing an older one."""

    def create(self, place: P, data: bytes) -> bool:
        """Write a new file; return False and change nothing if it exists.

        If any number of processes do this at once with different data, exactly one gets True.
        """

    def is_file(self, place: P) -> bool:
        """Return True if the file exists."""

    def entries(self, folder: P) -> list[Entry[P]]:
        """Return the entries of a folder, sorted by name; empty if there is no such folder."""

    def size_bytes(self, place: P) -> int:
        """Return the size of a file, or of a whole group."""

    def remove(self, place: P) -> bool:
        """Remove a file or a group so that readers never see half of it; False if missing."""

    def move(self, place: P, target: P) -> None:
        """Rename a file or a group to an unused name, creating folders as needed."""

    def publish_group(self, place: P, attributes: Mapping[str, Any], fill: FillGroup) -> None:
        """Write a Zarr group, whole or not at all; the first writer to finish wins.

        Parameters
        ----------
        attributes : mapping
            JSON-able; a backend may add the key `ARRAYS_IN`: the subgroup with the arrays.
        fill : callable
            Writes the arrays into the group passed to it.
        """

    def zarr_group(self, place: P) -> AbstractContextManager[ZarrAddress]:
        """Yield the address from which Zarr reads a group; errors inside become `StoreError`."""

    def prepare(self, root: P, folders: Sequence[P]) -> None:
        """Prepare a root for writing: make folders, or raise an error if that is impossible."""

    def why_no_store(self, root: P) -> str:
        """Return the reason why the root is not a store, worded to follow "it"."""

    def clean(self, root: P, folders: Sequence[P]) -> None:
        """Remove unfinished files where that is cheap."""

    def free_bytes(self, root: P) -> int | None:
        """Return the free space; None if unknown."""


def backend_of(place: Place) -> Backend[Any]:
    """Return the backend of a place.

    Raises
    ------
    StoreError
        If the place is in a bucket and obstore is not installed.
    """
    # Both modules import this one; the second needs obstore, which is optional.
    if isinstance(place, Path):
        from palpate.storage.backends import local as local_backend

        return cast(Backend[Any], local_backend)
    from palpate.storage.backends import objects as object_backend

    return cast(Backend[Any], object_backend)
