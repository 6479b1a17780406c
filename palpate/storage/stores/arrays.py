"""Named arrays in one Zarr group: the format of everything large in a store.

Format 3, zstd, published when complete. The group stores a CRC-32 of every array, because
Zarr reads a missing chunk as zeros without an error, and a checksum of its description.
"""

import math
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec

from palpate.storage.backends.contract import ARRAYS_IN, DESCRIPTION, backend_of
from palpate.storage.backends.places import Place
from palpate.storage.digest import digest
from palpate.storage.errors import StoreError
from palpate.storage.plain import from_plain, loads, to_plain
from palpate.storage.stores.store import check_schema

SCHEMA_VERSION = 1

VOLUME_EDGE = 128  # voxels along each edge of a chunk
CHUNK_BYTES = 16 * 2**20  # of other arrays, cut along their first axis
LEVEL = 3  # of zstd: faster than the disk, 100 : 1 on labels

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
    for name, array in arrays.items():
        _check_array(name, array)
    if exists(path):
        return
    attributes = {
        "schema_version": SCHEMA_VERSION,
        "meta": to_plain(meta or {}),
        "crc32": {name: _crc32(array) for name, array in arrays.items()},
    }
    attributes["checksum"] = _checksum(attributes)

    def fill(group: zarr.Group) -> None:
        for name, array in arrays.items():
            stored = group.create_array(
                name,
                shape=array.shape,
                dtype=array.dtype,
                chunks=_chunks(array),
                compressors=ZstdCodec(level=LEVEL),
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
        If the group is missing, lacks an array or is damaged.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    attributes = _attributes(path)
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
    return arrays, from_plain(attributes["meta"])


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


def exists(path: Place) -> bool:
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
    return attributes


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
