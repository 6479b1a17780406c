"""Tries what a store needs of the place where it lies: write, read, list, take once, remove."""

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
    """What was tried.

    Parameters
    ----------
    root : str
    free_bytes : int or None
        Room that is left; None where nobody knows, as in a bucket.
    takes_once : bool
        Whether of several that create one name, one after the other and at once, all but one
        are refused.
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
    content = secrets.token_bytes(PROBE_BYTES)
    taken = [folder / f"{written.stem}-{race}.probe" for race in range(RACES)]
    takes_once = all(_one_wins(store, place) for place in taken)
    backend.write(written, content)
    if backend.read(written) != content:
        raise StoreError(f"{written} was written and is read back with another content.")
    listed = {entry.place for entry in backend.entries(folder)}
    if written not in listed:
        raise StoreError(f"{written} was written, but {folder} does not list it.")
    for place in (written, *taken):
        backend.remove(place)
    return StoreProbe(str(store.root), backend.free_bytes(store.root), takes_once)


def _one_wins(store: Store, place: Place) -> bool:
    """Return whether one of several creates a name, and nobody afterwards.

    All at once, because a server may look first and write later.
    """
    together = Barrier(RIVALS)

    def create(who: int) -> bool:
        together.wait()
        return store.backend.create(place, b"%d" % who)

    with ThreadPoolExecutor(RIVALS) as pool:
        won = sum(pool.map(create, range(RIVALS)))
    return won == 1 and not store.backend.create(place, b"late")
