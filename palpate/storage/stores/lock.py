"""The maintenance lock of a store, for one process at a time on any machine.

The lock is a file that is created only if there is none, and removed at the end. A
process that is killed leaves it behind; the next one's error message explains how to remove it.
Running studies take no lock: they name their files by content.
"""

import os
import secrets
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

from palpate.storage.errors import StoreError
from palpate.storage.plain import dumps, loads
from palpate.storage.stores.store import Store

MAINTENANCE = "maintenance"


@contextmanager
def maintaining(store: Store, what: str) -> Iterator[None]:
    """Hold the store's lock.

    Parameters
    ----------
    what : str
        The command, shown to anyone who finds the lock.

    Raises
    ------
    StoreError
        If another process holds it, or the store cannot be written.
    """
    place = store.layout.lock(MAINTENANCE)
    owner = {
        "command": what,
        "host": socket.gethostname(),
        "pid": os.getpid(),
        "since": datetime.now(UTC).isoformat(timespec="seconds"),
        "token": secrets.token_hex(8),  # differs for every owner
    }
    if not store.backend.create(place, dumps(owner).encode()):
        raise StoreError(
            f"{store} is being maintained by {_owner(store)}. Wait for it to finish; if that "
            f"process is gone, remove {place} and run the command again."
        )
    try:
        yield
    finally:
        store.backend.remove(place)


def _owner(store: Store) -> str:
    try:
        owner = loads(store.backend.read(store.layout.lock(MAINTENANCE)))
        return f"`{owner['command']}` (process {owner['pid']} on {owner['host']}, {owner['since']})"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
