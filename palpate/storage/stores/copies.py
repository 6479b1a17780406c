"""Copies of entries between folders and buckets."""

from pathlib import Path

from palpate.storage.backends.atomic import explained
from palpate.storage.backends.contract import backend_of
from palpate.storage.backends.places import Place
from palpate.storage.stores.arrays import load_arrays, save_arrays


def copy_entry(source: Place, target: Place) -> None:
    """Copy a record or a group of arrays; an existing target is kept.

    A group is read with its checksums and written again, so the copy is known to be intact.

    Raises
    ------
    StoreError
        If the source is missing or damaged, or the target cannot be written.
    NewerSchemaError
        If a newer version of Palpate wrote the source.
    """
    if source.suffix == ".zarr":
        save_arrays(target, *load_arrays(source))
    elif not backend_of(target).is_file(target):
        backend_of(target).write(target, backend_of(source).read(source))


def local_copy(source: Place, folder: Path) -> Path:
    """Return a local path with the content of an entry.

    Parameters
    ----------
    source : Path or ObjectPath
        Entry of a store; a local one is not copied.
    folder : Path
        Receives the copy.

    Raises
    ------
    StoreError
        If the source cannot be read, or the folder cannot be written.
    """
    if isinstance(source, Path):
        return source
    place = folder / source.parent.name / source.name
    with explained(place):
        place.parent.mkdir(parents=True, exist_ok=True)
    copy_entry(source, place)
    return place
