"""Defines what a store asks of the place where it lies; two modules do it.

::

    palpate.storage.backends.local     a folder: temporary names, renamed when complete
    palpate.storage.backends.objects    a prefix in a bucket: conditional puts, descriptions last

Whatever has a name is whole, and of two writers of one name one wins: both modules keep this,
and `tests/storage/test_backends.py` tries it on both.
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
    """One thing in a folder of a store.

    Parameters
    ----------
    place : Path or ObjectPath
        Of a file, or of a group of arrays.
    modified_s : float
        When it was last written, seconds since 1970.
    half_written : bool
        Whether its writer has not finished, or never will; readers pass it over.
    """

    place: P
    modified_s: float
    half_written: bool


@dataclass(frozen=True, slots=True)
class ZarrAddress:
    """Where Zarr finds a group.

    Parameters
    ----------
    store : path or zarr store
    path : str
        Inside the store; empty for its root.
    """

    store: Any
    path: str

    def inside(self, *names: str) -> str:
        """Return the path of what lies in the group."""
        return "/".join(part for part in (self.path, *names) if part)


class Backend(Protocol[P]):
    """Reads and writes at one kind of place.

    All raise `StoreError` where the place cannot be read or written, with what to do.
    """

    def read(self, place: P) -> bytes:
        """Return the content of a file.

        Raises
        ------
        FileNotFoundError
            If it is not there.
        """

    def write(self, place: P, data: bytes) -> None:
        """Write a whole file or nothing; an older one is replaced."""

    def create(self, place: P, data: bytes) -> bool:
        """Write a file that is not there yet; False, and nothing is changed, if it is.

        Of any number of processes that do it at once, one gets True, if their data differ.
        """

    def is_file(self, place: P) -> bool:
        """Return whether a file is there."""

    def entries(self, folder: P) -> list[Entry[P]]:
        """Return what lies in a folder, sorted by name; nothing if there is no such folder."""

    def size_bytes(self, place: P) -> int:
        """Return the size of a file, or of all that lies in a group."""

    def remove(self, place: P) -> bool:
        """Remove a file or a group so that no reader meets half of it; False if not there."""

    def move(self, place: P, target: P) -> None:
        """Give a file or a group another name, which nobody has; folders are made."""

    def publish_group(self, place: P, attributes: Mapping[str, Any], fill: FillGroup) -> None:
        """Write a Zarr group, whole or not at all; if another writer is faster, his is kept.

        Parameters
        ----------
        attributes : mapping
            JSON-able; a backend may add the key `ARRAYS_IN`: the subgroup that has the arrays.
        fill : callable
            Writes the arrays into the group that it is given.
        """

    def zarr_group(self, place: P) -> AbstractContextManager[ZarrAddress]:
        """Give what Zarr reads a group from; what goes wrong within is explained."""

    def prepare(self, root: P, folders: Sequence[P]) -> None:
        """Make ready for writing a store: make folders, or refuse where none can be."""

    def why_no_store(self, root: P) -> str:
        """Say what is there where the description of a store is missing, after "it"."""

    def clean(self, root: P, folders: Sequence[P]) -> None:
        """Remove what writers have left half written, as far as that costs nothing."""

    def free_bytes(self, root: P) -> int | None:
        """Return the room that is left; None if nobody knows."""


def backend_of(place: Place) -> Backend[Any]:
    """Return what reads and writes at a place.

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
