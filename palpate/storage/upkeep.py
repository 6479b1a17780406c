"""Upkeep of a store: checks of every entry, the maintenance lock, migration to the current schema.

Nothing is repaired in place: a damaged entry is set aside and computed again when a study needs
it. Imported images cannot be computed again, so damaged entries go into the folder ``damaged`` of
the store instead of being removed.

The maintenance lock is for one process at a time on any machine. It is a file that is created only
if there is none, and removed at the end. A process that is killed leaves it behind; the next one's
error message explains how to remove it. Running studies take no lock: they name their files by
content.

A store is migrated one version at a time. There has been one schema so far, so there is no step
yet. An interrupted step is repeated as a whole, so it must be idempotent. The version in the
description of the store is raised after each step.
"""

import os
import secrets
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime

from palpate.storage import store as stores
from palpate.storage.backends.store_paths import Location, Place, place_of
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.json_digests import dumps, loads
from palpate.storage.store import Store, load_evaluation, stored_schema, write_schema
from palpate.storage.stored_arrays import has_field, has_sealed_name, has_volume, load_arrays

DAMAGED = "damaged"


@dataclass(frozen=True)
class Damage:
    """A damaged entry of a store.

    Parameters
    ----------
    path : Path or ObjectPath
    reason : str
    """

    path: Place
    reason: str


@dataclass(frozen=True)
class StoreCheck:
    """Result of a check.

    Parameters
    ----------
    counts : dict of str to int
        Number of entries by folder, damaged ones included.
    damages : list of Damage
    leftovers : list of Path or ObjectPath
        Entries that were unfinished when a process ended; readers skip them.
    unnamed : int
        Number of entries whose name is not sealed, written by an earlier version.
    """

    counts: dict[str, int]
    damages: list[Damage]
    leftovers: list[Place]
    unnamed: int


def check_store(store: Store) -> StoreCheck:
    """Read every array and record of a store, and verify their checksums and names.

    An evaluation whose field is missing or damaged counts as damaged.

    Raises
    ------
    NewerSchemaError
        If a newer version of Palpate wrote an entry.
    """
    layout = store.layout
    counts: dict[str, int] = {}
    damages: list[Damage] = []
    leftovers: list[Place] = []
    unnamed = 0
    for folder in layout.folders:
        entries = store.backend.entries(folder)
        leftovers += [entry.place for entry in entries if entry.half_written]
        whole = [entry.place for entry in entries if not entry.half_written]
        counts[folder.name] = len(whole)
        damaged = {damage.path for damage in damages}
        for entry in whole:
            reason, named = _verified(store, entry, damaged)
            unnamed += not named
            if reason:
                damages.append(Damage(entry, reason))
    return StoreCheck(counts, damages, leftovers, unnamed)


def set_aside(store: Store, damages: list[Damage]) -> Place:
    """Move damaged entries into a separate folder and return that folder.

    Raises
    ------
    StoreError
        If the place cannot be written.
    """
    root, backend = store.root / DAMAGED, store.backend
    for damage in damages:
        folder, name = root / damage.path.parent.name, damage.path.name
        taken = {entry.place.name for entry in backend.entries(folder)}
        numbered = (f"{name}.{number}" for number in range(2, len(taken) + 3))
        free = name if name not in taken else next(n for n in numbered if n not in taken)
        backend.move(damage.path, folder / free)
    return root


def _verified(store: Store, entry: Place, damaged: set[Place]) -> tuple[str, bool]:
    """Return what is wrong with an entry, if anything, and False if its name is not sealed."""
    try:
        if entry.parent == store.layout.evaluations:
            return _record_damage(store, entry, damaged), True
        load_arrays(entry)
        return "", has_sealed_name(entry)
    except NewerSchemaError:
        raise
    except StoreError as error:
        return str(error), True


def _record_damage(store: Store, entry: Place, damaged: set[Place]) -> str:
    if entry.suffix != ".json":
        return f"{entry} is not a record of an evaluation."
    record = load_evaluation(store, entry.stem)
    if record is None or record["status"] != "done":
        return ""
    if not has_field(store, entry.stem) or store.layout.field(entry.stem) in damaged:
        return f"{entry} is done, but its field is missing or damaged."
    volume = record.get("volume")
    if volume and (not has_volume(store, volume) or store.layout.volume(volume) in damaged):
        return f"{entry} names the volume {volume}, which is missing or damaged."
    return ""


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
            f"{store} is being maintained by {_lock_owner(store)}. Wait for it to finish; if that "
            f"process is gone, remove {place} and run the command again."
        )
    try:
        yield
    finally:
        store.backend.remove(place)


def _lock_owner(store: Store) -> str:
    try:
        owner = loads(store.backend.read(store.layout.lock(MAINTENANCE)))
        return f"`{owner['command']}` (process {owner['pid']} on {owner['host']}, {owner['since']})"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"


Step = Callable[[Store], None]

STEPS: Mapping[int, Step] = {}
"""Migration steps by the version they start from; each results in the next version."""


def migrate(location: Location) -> tuple[int, int]:
    """Migrate a store to the current schema, and return the version before and after.

    No other process may use the store meanwhile.

    Raises
    ------
    StoreError
        If there is no store, it cannot be written, or another process is maintaining it.
    NewerSchemaError
        If a newer version of Palpate made the store.
    """
    store = Store(place_of(location))
    before = stored_schema(store)
    if before is None:
        raise StoreError(f"{store} is not a store: it {store.backend.why_no_store(store.root)}.")
    version = before
    if version < stores.SCHEMA_VERSION:
        with maintaining(store, "palpate store migrate"):
            while version < stores.SCHEMA_VERSION:
                STEPS[version](store)
                version += 1
                write_schema(store, version)
    return before, version
