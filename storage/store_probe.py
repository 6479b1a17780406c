"""Tries what a store needs of the place where it lies: write, read, list, take once, remove."""

import os
import secrets
from dataclasses import dataclass

from storage.errors import StoreError
from storage.places import Location
from storage.stores import open_store

PROBE_BYTES = 4096


@dataclass(frozen=True, slots=True)
class StoreProbe:
    """What was tried.

    Parameters
    ----------
    root : str
    free_bytes : int or None
        Room that is left; None where nobody knows, as in a bucket.
    takes_once : bool
        Whether of two processes that create one name the second is refused.
    """

    root: str
    free_bytes: int | None
    takes_once: bool


def probe_store(location: Location) -> StoreProbe:
    """Try a store, which is made where it is missing; nothing is left behind.

    Raises
    ------
    StoreError
        If it cannot be written, read, listed or cleaned.
    """
    store = open_store(location)
    backend, folder = store.backend, store.layout.locks
    written = folder / f"{os.getpid()}-{secrets.token_hex(4)}.probe"
    taken = folder / f"{written.stem}-once.probe"
    content = secrets.token_bytes(PROBE_BYTES)
    first = backend.create(taken, content)
    second = backend.create(taken, content[::-1])
    backend.write(written, content)
    if backend.read(written) != content:
        raise StoreError(f"{written} was written and is read back with another content.")
    listed = {entry.place for entry in backend.entries(folder)}
    if not {written, taken} <= listed:
        raise StoreError(f"{written} was written, but {folder} does not list it.")
    for place in (written, taken):
        backend.remove(place)
    return StoreProbe(str(store.root), backend.free_bytes(store.root), first and not second)
