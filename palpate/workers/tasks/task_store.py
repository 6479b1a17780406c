"""Results of tasks: a record and arrays under the digest of everything they depend on.

A part is written completely or not at all, so a name exists only once its part is finished, and the
same name means the same content everywhere. Records are frozen dataclasses; see
`storage.records.typed_json`.
"""

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from numpy.typing import NDArray

from palpate.storage.backends.places import Location, Place
from palpate.storage.digest import array_digest, digest
from palpate.storage.errors import StoreError
from palpate.storage.records.typed_json import from_json, to_json
from palpate.storage.stores.arrays import Arrays, exists, load_arrays, load_meta, save_arrays
from palpate.storage.stores.store import open_store
from palpate.storage.stores.volumes import has_volume, load_volume, save_volume
from palpate.storage.values import Volume
from palpate.workers.resources import CACHE

R = TypeVar("R")
T = TypeVar("T")


class TaskStore:
    """The results of tasks in one store.

    Parameters
    ----------
    location : str or Path
        Location of the store, which is created if missing.

    Raises
    ------
    StoreError
        If the store cannot be used.
    """

    def __init__(self, location: Location) -> None:
        self.store = open_store(location)

    def path(self, name: str) -> Place:
        """Return the path of the part with this digest."""
        return self.store.layout.field(name)

    def has(self, name: str) -> bool:
        """Return True if a part is finished."""
        return exists(self.path(name))

    def save(self, name: str, record: object, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write a finished part, unless it already exists.

        Parameters
        ----------
        name : str
            Digest of everything the part depends on.
        record : dataclass
        arrays : mapping of str to ndarray

        Raises
        ------
        StoreError
            If the store cannot be written.
        """
        save_arrays(self.path(name), arrays, to_json(record))

    def record(self, name: str, kind: type[R]) -> R:
        """Read the record of a part, without its arrays.

        Raises
        ------
        StoreError
            If the part is missing or damaged, or its record is of another type.
        """
        return self._typed(name, kind, load_meta(self.path(name)))

    def load(self, name: str, kind: type[R]) -> tuple[R, Arrays]:
        """Read the record and the arrays of a part.

        Raises
        ------
        StoreError
            If the part is missing or damaged, or its record is of another type.
        """
        arrays, meta = load_arrays(self.path(name))
        return self._typed(name, kind, meta), arrays

    def add_volume(self, volume: Volume) -> str:
        """Store a volume under the digest of its content, and return the digest."""
        place = [list(volume.spacing_mm), list(volume.origin_mm), *volume.frame_facts]
        name = digest("image", array_digest(volume.values), place)
        if not has_volume(self.store, name):
            save_volume(self.store, name, volume, meta={"kind": "image"})
        return name

    def volume(self, name: str) -> Volume:
        """Return a stored volume, cached in this process."""
        return self.cached(("volume", name), lambda: load_volume(self.store, name))

    def cached(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return a value, computed once for this store in this process."""
        return CACHE.get(("task", str(self.store.root), key), make)

    def _typed(self, name: str, kind: type[R], meta: Mapping[str, Any]) -> R:
        try:
            return from_json(kind, meta)
        except ValueError as error:
            raise StoreError(
                f"{self.path(name)} has unexpected content: {error}. Remove that folder and run "
                "the same command again to recreate it."
            ) from error


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a task store, finished or not.

    Parameters
    ----------
    store : TaskStore
    name : str
        Digest of everything the part depends on.
    """

    store: TaskStore
    name: str

    @property
    def path(self) -> Place:
        """Path of the part."""
        return self.store.path(self.name)

    @property
    def is_finished(self) -> bool:
        """True if the part is in the store."""
        return self.store.has(self.name)

    def save(self, record: object, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write the part; see `TaskStore.save`."""
        self.store.save(self.name, record, arrays)

    def record(self, kind: type[R]) -> R:
        """Read the record; see `TaskStore.record`."""
        return self.store.record(self.name, kind)

    def load(self, kind: type[R]) -> tuple[R, Arrays]:
        """Read the record and the arrays; see `TaskStore.load`."""
        return self.store.load(self.name, kind)
