"""Voxel volumes in a store: phantoms, images, targets and deformed bodies.

The array ``values`` is chunked and compressed. Spacing, origin and the names of tissue labels
are attributes.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from palpate.storage.errors import InputError, StoreError
from palpate.storage.stores.arrays import exists, load_arrays, load_meta, save_arrays
from palpate.storage.stores.store import Store
from palpate.storage.values import Tissue, Triple, Volume

OWN = ("spacing_mm", "origin_mm", "frame_uid", "place_known", "labels", "shape", "dtype")
LABELS = {str(int(tissue)): tissue.name.lower() for tissue in Tissue}


def save_volume(
    store: Store, digest: str, volume: Volume, *, meta: Mapping[str, Any] | None = None
) -> None:
    """Write a volume, whole or not at all; an existing one is kept.

    Parameters
    ----------
    store : Store
    digest : str
        Digest of the volume.
    volume : Volume
    meta : mapping, optional
        Any JSON values, such as the source of the volume.

    Raises
    ------
    StoreError
        If the volume is not numeric, `meta` uses a reserved key, or the volume cannot be written.
    """
    clash = sorted(set(meta or {}) & set(OWN))
    if clash:
        raise StoreError(
            f"The metadata of a volume cannot contain {clash}: these keys are reserved."
        )
    values = volume.values
    attributes = {
        **(meta or {}),
        "spacing_mm": [float(s) for s in volume.spacing_mm],
        "origin_mm": [float(o) for o in volume.origin_mm],
        "labels": LABELS if _are_tissues(volume) else None,
        "shape": list(values.shape),
        "dtype": values.dtype.name,
        **({"frame_uid": volume.frame_uid} if volume.frame_uid else {}),
        **({} if volume.place_known else {"place_known": False}),
    }
    save_arrays(store.layout.volume(digest), {"values": values}, attributes)


def load_volume(store: Store, digest: str) -> Volume:
    """Read a volume.

    Raises
    ------
    StoreError
        If it is missing or damaged.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    arrays, meta = load_arrays(store.layout.volume(digest), ["values"])
    return Volume(
        arrays["values"],
        _triple(meta["spacing_mm"]),
        _triple(meta["origin_mm"]),
        frame_uid=str(meta.get("frame_uid", "")),
        place_known=bool(meta.get("place_known", True)),
    )


def volume_meta(store: Store, digest: str) -> dict[str, Any]:
    """Read the metadata of a volume, without reading its voxels.

    Returns
    -------
    dict
        The `meta` it was saved with, and ``spacing_mm`` and ``origin_mm`` (x, y, z),
        ``labels`` (name by label; None if the values are not tissues), ``shape``
        (nz, ny, nx) and ``dtype``; ``frame_uid`` and ``place_known`` if they differ from
        the defaults of `Volume`.

    Raises
    ------
    StoreError
        If it is missing or damaged.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    return load_meta(store.layout.volume(digest))


def has_volume(store: Store, digest: str) -> bool:
    """Return True if the volume exists and is complete."""
    return exists(store.layout.volume(digest))


def list_volumes(store: Store) -> list[str]:
    """Return the digests of all volumes, sorted."""
    entries = store.backend.entries(store.layout.volumes)
    whole = (entry.place for entry in entries if not entry.half_written)
    return sorted(place.stem for place in whole if place.suffix == ".zarr" and exists(place))


def named_volumes(store: Store) -> dict[str, list[str]]:
    """Return the digests of all named volumes, by name; replaced ones are included."""
    found: dict[str, list[str]] = {}
    for volume in list_volumes(store):
        with suppress(StoreError):  # a damaged volume has no name
            name = volume_meta(store, volume).get("name")
            if name is not None:
                found.setdefault(str(name), []).append(volume)
    return found


def remove_volume(store: Store, digest: str) -> bool:
    """Remove a volume; return False if it does not exist.

    Raises
    ------
    StoreError
        If the place cannot be written.
    """
    return store.backend.remove(store.layout.volume(digest))


def find_volume(store: Store, given: str) -> str | None:
    """Return the digest of the volume with this digest or name; None if there is none.

    Raises
    ------
    InputError
        If several volumes have the name.
    """
    if given in list_volumes(store):
        return given
    named = volumes_named(store, given)
    if len(named) > 1:
        raise InputError(f"{given} names several volumes: give one of {', '.join(named)}.")
    return named[0] if named else None


def volumes_named(store: Store, name: str) -> list[str]:
    """Return the digests of the volumes with a name, without replaced ones.

    A volume replaces others if its metadata lists their digests as ``replaces``: they stay for
    the studies that use them, but their name now refers to the new one.
    """
    named = {}
    for volume in list_volumes(store):
        with suppress(StoreError):  # a damaged volume has no name
            meta = volume_meta(store, volume)
            if meta.get("name") == name:
                named[volume] = meta
    replaced = {old for meta in named.values() for old in meta.get("replaces", ())}
    return [volume for volume in named if volume not in replaced]


def _are_tissues(volume: Volume) -> bool:
    values = volume.values
    return values.dtype == np.uint8 and values.size > 0 and int(values.max()) <= max(Tissue)


def _triple(values: list[float]) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z
