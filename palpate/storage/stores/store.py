"""The store shared by workers and driver: a local folder or a prefix in a bucket.

Volumes, meshes, fields and finished evaluations are stored by digest, so any study that
needs the same data finds them. Nothing in a store is changed once written; everything
but imported images can be computed again.
"""

from dataclasses import dataclass
from typing import Any

from palpate.storage.backends.contract import Backend, backend_of
from palpate.storage.backends.layout import StoreLayout
from palpate.storage.backends.places import Location, Place, place_of
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.plain import dumps, loads

SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class Store:
    """An opened store.

    Parameters
    ----------
    root : Path or ObjectPath
        Its folder, absolute; or its prefix in a bucket.
    """

    root: Place

    @property
    def layout(self) -> StoreLayout:
        """Return the paths of the store."""
        return StoreLayout(self.root)

    @property
    def backend(self) -> Backend[Any]:
        """Return the storage backend."""
        return backend_of(self.root)

    def __str__(self) -> str:
        return str(self.root)


def open_store(location: Location, *, create: bool = True) -> Store:
    """Open a store, or create one.

    Parameters
    ----------
    location : str, Path or ObjectPath
        A folder (``~`` is the user's home), or ``s3://``, ``gs://`` or ``az://BUCKET/PREFIX``.
    create : bool
        Create the store if it is missing, and prepare it for writing. Without it the
        store must exist and may be read-only.

    Raises
    ------
    StoreError
        If the location is missing, unreachable, not writable or not a store, or the store has an
        older schema.
    NewerSchemaError
        If a newer version of Palpate made the store.
    """
    store = Store(place_of(location))
    layout, backend = store.layout, store.backend
    version = stored_schema(store)
    if version is not None and version < SCHEMA_VERSION:
        raise StoreError(
            f"{store} has an older schema ({version}; this version uses {SCHEMA_VERSION}). Stop "
            f"all programs that use it and run `palpate store migrate --store {store}`."
        )
    if create:
        backend.prepare(layout.root, layout.folders)
        if version is None:
            write_schema(store, SCHEMA_VERSION)
    elif version is None:
        raise StoreError(
            f"{layout.root} is not a store: it {backend.why_no_store(layout.root)}. Give the "
            "store of an earlier run, or run a study to create one."
        )
    backend.clean(layout.root, layout.folders)
    return store


def write_schema(store: Store, version: int) -> None:
    """Write the description of a store with its schema version.

    Raises
    ------
    StoreError
        If the place cannot be written.
    """
    about = "A store of Palpate: volumes, meshes and evaluations by digest."
    text = dumps({"schema_version": version, "about": about})
    store.backend.write(store.layout.marker, text.encode() + b"\n")


def stored_schema(store: Store) -> int | None:
    """Return the schema version of a store; None if there is no store.

    Raises
    ------
    StoreError
        If the description of the store cannot be read or is damaged.
    NewerSchemaError
        If a newer version of Palpate made the store.
    """
    marker = store.layout.marker
    try:
        version = loads(store.backend.read(marker))["schema_version"]
        check_schema(version, SCHEMA_VERSION, store.root)
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(
            f"{marker} is damaged ({error}). Remove that file and run the study again; the "
            "contents of the store are kept."
        ) from error
    return int(version)


def check_schema(version: Any, known: int, where: object) -> None:
    """Raise an error if a newer version of Palpate wrote this.

    Raises
    ------
    NewerSchemaError
        If `version` is above `known`.
    ValueError
        If `version` is not a version number.
    """
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise ValueError(f"schema_version is {version!r}, expected a whole number from 1")
    if version > known:
        raise NewerSchemaError(
            f"{where} was written by a newer version of Palpate (schema {version}; this version "
            f"reads up to {known}). Upgrade with `pip install --upgrade palpate`."
        )
