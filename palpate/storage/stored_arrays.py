"""Everything large in a store, as named arrays in Zarr: volumes, displacements and meshes.

Format 3, zstd, published when complete. A group stores a CRC-32 of every array, because
Zarr reads a missing chunk as zeros without an error, a checksum of its description, and its own
name with a checksum of both, because one whole group may be put in the place of another. Groups of
earlier versions lack the name or both checksums: they can be read, but not verified. Entries are
copied between folders and buckets.

The array ``values`` of a voxel volume (a phantom, an image, a target or a deformed body) is
chunked and compressed. Spacing, origin and the names of tissue labels are attributes.

Nodal displacements are small and always kept: the deformed volume can be computed again from
mesh, reference volume and displacement.
"""

import math
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec

from palpate.storage.backends.atomic_files import explained
from palpate.storage.backends.store_paths import ARRAYS_IN, DESCRIPTION, Place
from palpate.storage.errors import InputError, StoreError
from palpate.storage.json_digests import digest, from_plain, loads, to_plain
from palpate.storage.store import Store, backend_of, check_schema
from palpate.storage.values import FloatArray, Tissue, Triple, Volume

SCHEMA_VERSION = 1

VOLUME_EDGE = 128  # voxels along each edge of a chunk
CHUNK_BYTES = 16 * 2**20  # of other arrays, cut along their first axis
ZSTD_LEVEL = 3  # of zstd: faster than the disk, 100 : 1 on labels

AXES = {3: ("z", "y", "x")}

Arrays = dict[str, NDArray[Any]]
Meta = dict[str, Any]


def save_arrays(
    path: Place, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any] | None = None
) -> None:
    """Write arrays as one group, whole or not at all.

    If `path` exists already, or another writer finishes first, that group is kept: equal
    names mean equal content.

    Parameters
    ----------
    path : Path or ObjectPath
        Path of the new group; a local one must have its folder.
    arrays : mapping of str to ndarray
        Numbers or booleans of any shape, in any memory layout.
    meta : mapping, optional
        JSON-able; numbers may be infinite below the top level.

    Raises
    ------
    StoreError
        If an array is not numeric, or the place cannot be written.
    """
    _publish(path, arrays, meta or {}, named=True)


def _publish(
    path: Place, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any], *, named: bool
) -> None:
    for name, array in arrays.items():
        _check_array(name, array)
    if has_arrays(path):
        return
    attributes = {
        "schema_version": SCHEMA_VERSION,
        "meta": to_plain(meta),
        "crc32": {name: _crc32(array) for name, array in arrays.items()},
    }
    attributes["checksum"] = _checksum(attributes)
    if named:
        attributes["name"] = _entry_name(path)
        attributes["name_checksum"] = _name_checksum(attributes)

    def fill(group: zarr.Group) -> None:
        for name, array in arrays.items():
            stored = group.create_array(
                name,
                shape=array.shape,
                dtype=array.dtype,
                chunks=_chunks(array),
                compressors=ZstdCodec(level=ZSTD_LEVEL),
                dimension_names=AXES.get(array.ndim),
                # Zarr would omit chunks of -0.0 and return 0.0.
                config={"write_empty_chunks": True},
            )
            stored[...] = array

    backend_of(path).publish_group(path, attributes, fill)


def load_arrays(path: Place, names: Iterable[str] | None = None) -> tuple[Arrays, Meta]:
    """Read a group.

    Parameters
    ----------
    path : Path or ObjectPath
    names : iterable of str, optional
        Arrays to read; all by default.

    Returns
    -------
    arrays : dict of str to ndarray
        C-ordered, in the byte order of this machine.
    meta : dict

    Raises
    ------
    StoreError
        If the group is missing, lacks an array, is damaged or was written under another name.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    attributes = _attributes(path)
    return _arrays(path, attributes, names), from_plain(attributes["meta"])


def has_sealed_name(path: Place) -> bool:
    """Return True if the name of a group was written with it; False in earlier versions.

    Raises
    ------
    StoreError
        If the group is missing or damaged.
    """
    return "name" in _attributes(path)


def _arrays(path: Place, attributes: dict[str, Any], names: Iterable[str] | None) -> Arrays:
    checksums: dict[str, int] = attributes["crc32"]
    arrays: Arrays = {}
    for name in checksums if names is None else names:
        if name not in checksums:
            raise StoreError(f"{path} has no array {name!r}, only: {', '.join(sorted(checksums))}.")
        array = _read_array(path, attributes.get(ARRAYS_IN, ""), name)
        array = array.astype(array.dtype.newbyteorder("="), order="C", copy=False)
        if _crc32(array) != checksums[name]:
            raise _damaged(path, f"the checksum of array {name!r} is wrong")
        arrays[name] = array
    return arrays


def load_meta(path: Place) -> Meta:
    """Read the `meta` of a group, without the arrays.

    Raises
    ------
    StoreError
        If the group is missing or damaged.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    return from_plain(_attributes(path)["meta"])


def has_arrays(path: Place) -> bool:
    """Return True if the group exists and is complete."""
    return backend_of(path).is_file(path / DESCRIPTION)


def _read_array(path: Place, inside: str, name: str) -> NDArray[Any]:
    with backend_of(path).zarr_group(path) as group:
        try:
            stored = zarr.open_array(group.store, path=group.inside(inside, name), mode="r")
            return np.asarray(stored[...])
        except (OSError, ValueError, RuntimeError, KeyError) as error:
            raise _damaged(path, f"array {name!r} cannot be read: {error}") from error


def _attributes(path: Place) -> dict[str, Any]:
    try:
        attributes = loads(backend_of(path).read(path / DESCRIPTION))["attributes"]
        check_schema(attributes["schema_version"], SCHEMA_VERSION, path)
    except FileNotFoundError as error:
        raise StoreError(
            f"{path} is not in the store. Run the study again to create it."
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise _damaged(path, f"its description cannot be read: {error!r}") from error
    if not all(isinstance(attributes.get(key), dict) for key in ("meta", "crc32")):
        raise _damaged(path, "its description is incomplete")
    if attributes.get("checksum", _checksum(attributes)) != _checksum(attributes):
        raise _damaged(path, "the checksum of its description is wrong")
    if "name" in attributes:
        _check_name(path, attributes)
    return attributes


def _check_name(path: Place, attributes: Mapping[str, Any]) -> None:
    if attributes.get("name_checksum") != _name_checksum(attributes):
        raise _damaged(path, "the checksum of its name is wrong")
    if attributes["name"] != _entry_name(path):
        raise StoreError(
            f"{path} is damaged: it was written as {attributes['name']}, so entries of this store "
            "were exchanged. Put it back under that name, or set it aside with `palpate store "
            "check --repair` and run the study again."
        )


def _entry_name(path: Place) -> str:
    """Return the kind and digest of an entry, such as ``meshes/3f2a9c0d1b7e6a54``."""
    return f"{path.parent.name}/{path.stem}"


def _name_checksum(attributes: Mapping[str, Any]) -> str:
    return digest(attributes["name"], attributes.get("checksum", ""))


def _checksum(attributes: Mapping[str, Any]) -> str:
    """Return the checksum of a description; descriptions of earlier versions store none."""
    return digest(*(attributes[key] for key in ("schema_version", "meta", "crc32")))


def _damaged(path: Place, what: str) -> StoreError:
    return StoreError(
        f"{path} is damaged: {what}. Remove that folder and run the study again to recreate it."
    )


def _check_array(name: str, array: NDArray[Any]) -> None:
    if array.dtype.kind not in "biufc":
        raise StoreError(
            f"Array {name!r} is of type {array.dtype}, expected numbers or booleans. "
            "Put text into the metadata."
        )
    if not name or name.startswith(("_", ".", "zarr.json")) or "/" in name:
        raise StoreError(f"{name!r} cannot be the name of an array; use letters, digits and dots.")


def _crc32(array: NDArray[Any]) -> int:
    little = array.astype(array.dtype.newbyteorder("<"), order="C", copy=False)
    return zlib.crc32(np.ascontiguousarray(little).data)


def _chunks(array: NDArray[Any]) -> tuple[int, ...]:
    if array.ndim == 3:
        return tuple(min(max(length, 1), VOLUME_EDGE) for length in array.shape)
    if array.ndim == 0:
        return ()
    first, *rest = array.shape
    row_bytes = max(math.prod(rest) * array.dtype.itemsize, 1)
    rows = min(max(CHUNK_BYTES // row_bytes, 1), max(first, 1))
    return rows, *(max(length, 1) for length in rest)


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
        # A name that was never verified is not sealed by copying it.
        _publish(target, *load_arrays(source), named=has_sealed_name(source))
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


VOLUME_ATTRIBUTES = (
    "spacing_mm",
    "origin_mm",
    "frame_uid",
    "place_known",
    "labels",
    "shape",
    "dtype",
)
TISSUE_LABELS = {str(int(tissue)): tissue.name.lower() for tissue in Tissue}


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
    clash = sorted(set(meta or {}) & set(VOLUME_ATTRIBUTES))
    if clash:
        raise StoreError(
            f"The metadata of a volume cannot contain {clash}: these keys are reserved."
        )
    values = volume.values
    attributes = {
        **(meta or {}),
        "spacing_mm": [float(s) for s in volume.spacing_mm],
        "origin_mm": [float(o) for o in volume.origin_mm],
        "labels": TISSUE_LABELS if _are_tissues(volume) else None,
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
    return has_arrays(store.layout.volume(digest))


def list_volumes(store: Store) -> list[str]:
    """Return the digests of all volumes, sorted."""
    entries = store.backend.entries(store.layout.volumes)
    whole = (entry.place for entry in entries if not entry.half_written)
    return sorted(place.stem for place in whole if place.suffix == ".zarr" and has_arrays(place))


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


def save_field(store: Store, digest: str, displacement_mm: FloatArray) -> None:
    """Write the displacement of the nodes of a mesh, whole or not at all.

    Parameters
    ----------
    store : Store
    digest : str
        Digest of the evaluation.
    displacement_mm : ndarray of float64, shape (n, 3)

    Raises
    ------
    StoreError
        If the shape or type is wrong, or the place cannot be written.
    """
    shape, dtype = displacement_mm.shape, displacement_mm.dtype
    if len(shape) != 2 or shape[1] not in (2, 3) or dtype != np.float64:
        raise StoreError(
            f"A displacement field has shape {shape} and type {dtype}, "
            "expected (n, 3), or (n, 2) for a section, and float64."
        )
    save_arrays(store.layout.field(digest), {"displacement_mm": displacement_mm})


def load_field(store: Store, digest: str) -> FloatArray:
    """Read a displacement, shape (n, 3) in mm.

    Raises
    ------
    StoreError
        If it is missing or damaged.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    arrays, _ = load_arrays(store.layout.field(digest), ["displacement_mm"])
    return arrays["displacement_mm"]


def has_field(store: Store, digest: str) -> bool:
    """Return True if the field exists and is complete."""
    return has_arrays(store.layout.field(digest))


def save_mesh(
    store: Store, digest: str, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]
) -> None:
    """Write the arrays of a mesh or a hierarchy, whole or not at all.

    Raises
    ------
    StoreError
        If an array is not numeric, or the mesh cannot be written.
    """
    save_arrays(store.layout.mesh(digest), arrays, meta)


def load_mesh(store: Store, digest: str) -> tuple[Arrays, Meta]:
    """Read a mesh or a hierarchy; see `save_mesh`.

    Raises
    ------
    StoreError
        If it is missing or damaged.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    return load_arrays(store.layout.mesh(digest))


def has_mesh(store: Store, digest: str) -> bool:
    """Return True if the mesh exists and is complete."""
    return has_arrays(store.layout.mesh(digest))
