"""Looks at everything in a store, and sets aside what is damaged.

Nothing is mended in place: what is set aside is made again when a study next asks for it.
Images that were imported are made by nobody, so all goes into the folder ``damaged`` of
the store instead of being removed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from storage.arrays import load_arrays
from storage.atomic import explained, is_temporary
from storage.errors import NewerSchemaError, StoreError
from storage.evaluations import load_evaluation
from storage.fields import has_field
from storage.stores import Store
from storage.volumes import has_volume

DAMAGED = "damaged"


@dataclass(frozen=True)
class Damage:
    """One thing of a store that cannot be used.

    Parameters
    ----------
    path : Path
    reason : str
    """

    path: Path
    reason: str


@dataclass(frozen=True)
class StoreCheck:
    """What a check has found.

    Parameters
    ----------
    counts : dict of str to int
        Entries by folder, damaged ones included.
    damages : list of Damage
    leftovers : list of Path
        Half written when a process ended; readers pass them over.
    """

    counts: dict[str, int]
    damages: list[Damage]
    leftovers: list[Path]


def check_store(store: Store) -> StoreCheck:
    """Read every array and record of a store, and compare with their checksums.

    An evaluation vouches for its field, so a field that is missing or damaged damages it.

    Raises
    ------
    NewerSchemaError
        If a newer version of Palpate wrote an entry.
    """
    layout = store.layout
    counts: dict[str, int] = {}
    damages: list[Damage] = []
    leftovers: list[Path] = []
    for folder in layout.folders:
        entries = sorted(folder.iterdir()) if folder.is_dir() else []
        leftovers += [entry for entry in entries if is_temporary(entry)]
        whole = [entry for entry in entries if not is_temporary(entry)]
        counts[folder.name] = len(whole)
        damages += list(_damages(store, folder, whole, {damage.path for damage in damages}))
    return StoreCheck(counts, damages, leftovers)


def set_aside(store: Store, damages: list[Damage]) -> Path:
    """Move what is damaged into a folder of its own and return that.

    Raises
    ------
    StoreError
        If the file system refuses.
    """
    root = store.root / DAMAGED
    for damage in damages:
        target = root / damage.path.parent.name
        with explained(target):
            target.mkdir(parents=True, exist_ok=True)
            number, place = 1, target / damage.path.name
            while place.exists():
                number += 1
                place = target / f"{damage.path.name}.{number}"
            damage.path.rename(place)
    return root


def _damages(
    store: Store, folder: Path, entries: list[Path], damaged: set[Path]
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


def _record_damage(store: Store, entry: Path, damaged: set[Path]) -> str:
    if entry.suffix != ".json":
        return f"{entry} is no record of an evaluation."
    record = load_evaluation(store, entry.stem)
    if record is None or record["status"] != "done":
        return ""
    if not has_field(store, entry.stem) or store.layout.field(entry.stem) in damaged:
        return f"{entry} is done, but its field is missing or damaged."
    volume = record.get("volume")
    if volume and (not has_volume(store, volume) or store.layout.volume(volume) in damaged):
        return f"{entry} names the volume {volume}, which is missing or damaged."
    return ""
