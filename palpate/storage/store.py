"""The store shared by workers and driver: a local folder or a prefix in a bucket.

Volumes, meshes, fields and finished evaluations are stored by digest, so any study that
needs the same data finds them. Nothing in a store is changed once written; everything
but imported images can be computed again.

A probe checks that a place can hold a store: write, read, list, create once, remove.

The record of a finished evaluation is written last, after field and volume, so its existence
guarantees theirs.
"""

import os
import secrets
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Barrier
from typing import Any, cast

from palpate.storage.backends.store_paths import Backend, Location, Place, StoreLayout, place_of
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.json_digests import dumps, from_plain, loads, seal, to_plain, unseal
from palpate.storage.values import EvaluationResult

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


def backend_of(place: Place) -> Backend[Any]:
    """Return the backend of a place.

    Raises
    ------
    StoreError
        If the place is in a bucket and obstore is not installed.
    """
    # Zarr is slow to load, and who reads a journal needs none; obstore is optional.
    if isinstance(place, Path):
        from palpate.storage.backends import folder_backend

        return cast(Backend[Any], folder_backend)
    from palpate.storage.backends import bucket_backend

    return cast(Backend[Any], bucket_backend)


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


PROBE_BYTES = 4096
PROBE_RACES, PROBE_RIVALS = 4, 8


@dataclass(frozen=True, slots=True)
class StoreProbe:
    """Result of the checks of a store.

    Parameters
    ----------
    root : str
    free_bytes : int or None
        Free space; None if unknown, as in a bucket.
    takes_once : bool
        True if creating a name succeeds exactly once, for attempts made one after the other and
        at the same time.
    """

    root: str
    free_bytes: int | None
    takes_once: bool


def probe_store(location: Location) -> StoreProbe:
    """Test a store, creating it if missing; no test files remain.

    Raises
    ------
    StoreError
        If it cannot be written, read, listed or cleaned.
    """
    store = open_store(location)
    backend, folder = store.backend, store.layout.locks
    written = folder / f"{os.getpid()}-{secrets.token_hex(4)}.probe"
    content = secrets.token_bytes(PROBE_BYTES)
    taken = [folder / f"{written.stem}-{race}.probe" for race in range(PROBE_RACES)]
    takes_once = all(_one_wins(store, place) for place in taken)
    backend.write(written, content)
    if backend.read(written) != content:
        raise StoreError(f"{written} was written but read back with different content.")
    listed = {entry.place for entry in backend.entries(folder)}
    if written not in listed:
        raise StoreError(f"{written} was written, but {folder} does not list it.")
    for place in (written, *taken):
        backend.remove(place)
    return StoreProbe(str(store.root), backend.free_bytes(store.root), takes_once)


def _one_wins(store: Store, place: Place) -> bool:
    """Return True if one of several attempts creates a name, and all others fail.

    The attempts run at the same time, because a server may check first and write later.
    """
    together = Barrier(PROBE_RIVALS)

    def create(who: int) -> bool:
        together.wait()
        return store.backend.create(place, b"%d" % who)

    with ThreadPoolExecutor(PROBE_RIVALS) as pool:
        won = sum(pool.map(create, range(PROBE_RIVALS)))
    return won == 1 and not store.backend.create(place, b"late")


EVALUATION_SCHEMA = 1


def save_evaluation(store: Store, digest: str, record: Mapping[str, Any]) -> None:
    """Write the record of an evaluation, whole or not at all.

    Parameters
    ----------
    store : Store
    digest : str
        Digest of the evaluation, which is also part of the record.
    record : mapping
        JSON-able; numbers below its top level may be infinite or NaN.

    Raises
    ------
    StoreError
        If the place cannot be written.
    """
    text = dumps({"schema_version": EVALUATION_SCHEMA, "record": to_plain(record)})
    store.backend.write(store.layout.evaluation(digest), seal(text).encode() + b"\n")


def load_evaluation(store: Store, digest: str) -> EvaluationResult | None:
    """Read the record of an evaluation; None if it has not finished.

    Raises
    ------
    StoreError
        If the record is damaged, or is that of another evaluation.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    path = store.layout.evaluation(digest)
    try:
        written, _ = unseal(store.backend.read(path))
        check_schema(written["schema_version"], EVALUATION_SCHEMA, path)
        record = from_plain(dict(written["record"]))
        if record["digest"] != digest:
            raise ValueError(
                f"it holds the evaluation {record['digest']}, so files of this store were exchanged"
            )
        return cast(EvaluationResult, record)
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(
            f"{path} is damaged: {error}. Remove that file and run the study again: this "
            "evaluation is computed again."
        ) from error
