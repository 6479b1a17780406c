"""Checks of every entry in a store; damaged ones are set aside.

Nothing is repaired in place: an entry that is set aside is computed again when a study needs it.
Imported images cannot be computed again, so damaged entries go into the folder ``damaged`` of
the store instead of being removed.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from palpate.storage.backends.places import Place
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.records.evaluations import load_evaluation
from palpate.storage.stores.arrays import load_arrays
from palpate.storage.stores.fields import has_field
from palpate.storage.stores.store import Store
from palpate.storage.stores.volumes import has_volume

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
    """

    counts: dict[str, int]
    damages: list[Damage]
    leftovers: list[Place]


def check_store(store: Store) -> StoreCheck:
    """Read every array and record of a store, and verify their checksums.

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
    for folder in layout.folders:
        entries = store.backend.entries(folder)
        leftovers += [entry.place for entry in entries if entry.half_written]
        whole = [entry.place for entry in entries if not entry.half_written]
        counts[folder.name] = len(whole)
        damages += list(_damages(store, folder, whole, {damage.path for damage in damages}))
    return StoreCheck(counts, damages, leftovers)


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


def _damages(
    store: Store, folder: Place, entries: list[Place], damaged: set[Place]
) -> Iterator[Damage]:
    records = folder == store.layout.evaluations
    for entry in entries:
        try:
            if records:
                reason = _record_damage(store, entry, damaged)
            else:
                load_arrays(entry)
                reason = ""
        except NewerSchemaError:
            raise
        except StoreError as error:
            reason = str(error)
        if reason:
            yield Damage(entry, reason)


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
