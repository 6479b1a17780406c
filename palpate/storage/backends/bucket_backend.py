"""Storage backend for a bucket; see `storage.backends.store_paths.Backend`.

Single objects are written atomically, but groups of them are not. The arrays of a group are in a
subgroup that only its writer knows; the description of the group is put last, only if there is none
yet, and names that subgroup::

    <digest>.zarr/zarr.json             put last, by one writer
    <digest>.zarr/w-<random>/values/    the arrays of that writer

So the arrays of two writers cannot mix, even on a server that ignores conditions. A group without a
description is unfinished; `palpate store gc` removes it.
"""

import json
import secrets
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import zarr
from zarr.abc.buffer import Buffer
from zarr.storage import MemoryStore, ObjectStore

from palpate.storage.backends.bucket_client import (
    FIRST_PATIENCE_S,
    FIRST_PAUSE_S,
    client_of,
    explained,
    was_cut_off,
)
from palpate.storage.backends.store_paths import (
    ARRAYS_IN,
    DESCRIPTION,
    Entry,
    FillGroup,
    ObjectPath,
    ZarrAddress,
)

if TYPE_CHECKING:
    from obstore import ObjectMeta

MOST_AT_ONCE = 1000  # objects per removal request
PUTS_AT_ONCE = 8


def read(place: ObjectPath) -> bytes:
    """Return the content of an object."""
    import obstore

    client = client_of(place)
    with explained(place):
        return bytes(obstore.get(client, place.key).bytes())


def write(place: ObjectPath, data: bytes) -> None:
    """Put an object."""
    import obstore

    client = client_of(place)
    with explained(place):
        obstore.put(client, place.key, data, use_multipart=False)


def create(place: ObjectPath, data: bytes) -> bool:
    """Put a new object, only if there is none with that name.

    The client does not retry a conditional put whose response is lost; the stored object is
    compared instead.
    """
    import obstore
    from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError

    client, until = client_of(place), time.monotonic() + FIRST_PATIENCE_S
    while True:
        try:
            obstore.put(client, place.key, data, mode="create", use_multipart=False)
            return True
        except (AlreadyExistsError, PreconditionError):
            # Perhaps our own, put twice because the first response was lost.
            return read(place) == data
        except (BaseError, FileNotFoundError) as error:
            if not was_cut_off(error) or time.monotonic() > until:
                with explained(place):
                    raise
        time.sleep(FIRST_PAUSE_S)


def is_file(place: ObjectPath) -> bool:
    """Return True if the object exists."""
    import obstore

    client = client_of(place)
    try:
        with explained(place):
            obstore.head(client, place.key)
    except FileNotFoundError:
        return False
    return True


def entries(folder: ObjectPath) -> list[Entry[ObjectPath]]:
    """Return the entries of a folder, from one listing of everything below it."""
    below: dict[str, list[ObjectMeta]] = defaultdict(list)
    for meta in _objects(folder):
        below[meta["path"].removeprefix(f"{folder.key}/").partition("/")[0]].append(meta)
    listed = []
    for name, objects in sorted(below.items()):
        whole = {f"{folder.key}/{name}", f"{folder.key}/{name}/{DESCRIPTION}"}
        modified_s = max(meta["last_modified"].timestamp() for meta in objects)
        half_written = not any(meta["path"] in whole for meta in objects)
        listed.append(Entry(folder / name, modified_s, half_written))
    return listed


def size_bytes(place: ObjectPath) -> int:
    """Return the size of an object, or of all objects of a group."""
    import obstore

    client = client_of(place)
    try:
        with explained(place):
            return obstore.head(client, place.key)["size"]
    except FileNotFoundError:
        return sum(found["size"] for found in _objects(place))


def remove(place: ObjectPath) -> bool:
    """Remove an object, or all objects of a group, its description first."""
    found = _keys(place)
    first = [key for key in found if key in (place.key, f"{place.key}/{DESCRIPTION}")]
    _delete(place, first)
    _delete(place, [key for key in found if key not in first])
    return bool(found)


def move(place: ObjectPath, target: ObjectPath) -> None:
    """Copy an object, or all objects of a group, then remove the originals."""
    import obstore

    client = client_of(place)
    with explained(place):
        for key in _keys(place):
            obstore.copy(client, key, target.key + key.removeprefix(place.key))
    remove(place)


def publish_group(place: ObjectPath, attributes: Mapping[str, Any], fill: FillGroup) -> None:
    """Write the arrays into a new subgroup, then the description of the group.

    Zarr fills a store in memory, and its objects are then uploaded in parallel. Writing directly to
    a bucket, Zarr would also describe every folder above the group, after looking for each one.
    """
    own = place / f"w-{secrets.token_hex(8)}"
    packed: dict[str, Buffer] = {}
    fill(zarr.create_group(MemoryStore(packed), zarr_format=3))
    with ThreadPoolExecutor(PUTS_AT_ONCE) as pool:
        for _ in pool.map(lambda key: write(own / key, packed[key].to_bytes()), packed):
            pass
    described = {
        "zarr_format": 3,
        "node_type": "group",
        "attributes": {**attributes, ARRAYS_IN: own.name},
    }
    if not create(place / DESCRIPTION, json.dumps(described, allow_nan=False).encode()):
        remove(own)


@contextmanager
def zarr_group(place: ObjectPath) -> Iterator[ZarrAddress]:
    """Yield the address of the group."""
    client = client_of(place)
    with explained(place):
        yield ZarrAddress(ObjectStore(client, read_only=True), place.key)


def prepare(root: ObjectPath, folders: Sequence[ObjectPath]) -> None:
    """Do nothing: a bucket has no folders."""


def why_no_store(root: ObjectPath) -> str:
    """Return the reason why the prefix is not a store."""
    return "has no palpate-store.json"


def clean(root: ObjectPath, folders: Sequence[ObjectPath]) -> None:
    """Do nothing: finding unfinished objects takes a full listing; see `palpate store gc`."""


def free_bytes(root: ObjectPath) -> int | None:
    """Return None: the free space of a bucket is unknown."""
    return None


def _objects(folder: ObjectPath) -> "Iterator[ObjectMeta]":
    import obstore

    client = client_of(folder)
    with explained(folder):
        for page in obstore.list(client, f"{folder.key}/".lstrip("/")):
            yield from page


def _keys(place: ObjectPath) -> list[str]:
    """Return the keys of an object, or of all objects of a group."""
    own = [place.key] if place.key and is_file(place) else []
    return own + [found["path"] for found in _objects(place)]


def _delete(place: ObjectPath, keys: list[str]) -> None:
    """Remove objects, which other processes may remove at the same time."""
    import obstore

    client = client_of(place)
    for start in range(0, len(keys), MOST_AT_ONCE):
        some = keys[start : start + MOST_AT_ONCE]
        try:
            with explained(place):
                obstore.delete(client, some)
        except FileNotFoundError:  # some of the others may still exist
            for key in some:
                with explained(place), suppress(FileNotFoundError):
                    obstore.delete(client, key)
