"""Checks that a place can hold a store: write, read, list, create once, remove."""

import os
import secrets
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Barrier

from palpate.storage.backends.places import Location, Place
from palpate.storage.errors import StoreError
from palpate.storage.stores.store import Store, open_store

PROBE_BYTES = 4096
RACES, RIVALS = 4, 8


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
    taken = [folder / f"{written.stem}-{race}.probe" for race in range(RACES)]
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
    together = Barrier(RIVALS)

    def create(who: int) -> bool:
        together.wait()
        return store.backend.create(place, b"%d" % who)

    with ThreadPoolExecutor(RIVALS) as pool:
        won = sum(pool.map(create, range(RIVALS)))
    return won == 1 and not store.backend.create(place, b"late")
