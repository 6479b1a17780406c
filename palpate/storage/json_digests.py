"""Values and dataclasses as JSON, names derived from their content, and checksums of lines.

JSON has no infinity and no NaN, but a perfect score is ``-inf`` and a failed
one ``inf``. They are written as the strings "-inf", "inf" and "nan", and read back
as numbers wherever a record expects a number.

A frozen dataclass has one schema for both directions. A field without a default is always
written, None as null. A field whose default is None is omitted while it is None, so that a record
contains only the quantities that were computed.

A digest is the first 16 hexadecimal digits of SHA-256: among a million names, two are equal
with a probability of 3e-8. Equal content has an equal digest in any process, on any machine
and in any order of keys; floats differ if any bit differs.

The checksum of a record is the last field of its line of JSON and covers every byte before it, so
a changed digit is found even if it parses to the same number. Records of earlier versions have
none: they can be read, but not verified. Lines of a journal also contain the checksum of the line
before; see `storage.journal`.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from palpate.storage.errors import InputError

_NUMBERS = {"-inf": -math.inf, "inf": math.inf, "nan": math.nan}


def to_plain(value: Any, *, finite: bool = False, where: str = "value") -> Any:
    """Copy `value` using dict, list, str, int, float, bool and None only.

    Parameters
    ----------
    value : mapping, sequence, numpy scalar or any JSON value
    finite : bool
        Reject infinities and NaN instead of writing them as text.
    where : str
        Name of the value in error messages.

    Raises
    ------
    InputError
        If `finite` is set and a number is not finite.
    TypeError
        If the value cannot be written as JSON, or two keys of a mapping become the same text.
    """
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, str):
        return str(value)
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        if finite:
            raise InputError(f"{where} is {value}, expected a finite number.")
        return str(float(value))
    if isinstance(value, Mapping):
        return _plain_mapping(value, finite, where)
    if isinstance(value, Sequence) and not isinstance(value, (bytes, bytearray)):
        return [
            to_plain(item, finite=finite, where=f"{where}[{i}]") for i, item in enumerate(value)
        ]
    expected = "a list in a fixed order" if isinstance(value, Set) else "a plain value"
    raise TypeError(f"{where} is of type {type(value).__name__}, expected {expected}")


def _plain_mapping(value: Mapping[Any, Any], finite: bool, where: str) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for key, item in value.items():
        name = to_plain(key)
        if isinstance(name, bool) or not isinstance(name, (str, int)):
            raise TypeError(f"{where} has the key {key!r}, expected text or an integer")
        if str(name) in plain:
            raise TypeError(f"{where} has the key {name} twice, as text and as a number")
        plain[str(name)] = to_plain(item, finite=finite, where=f"{where}.{name}")
    return plain


def to_number(value: Any) -> Any:
    """Undo `to_plain` for numbers, at any depth: "-inf", "inf" and "nan" become floats."""
    if isinstance(value, str):
        return _NUMBERS.get(value, value)
    if isinstance(value, dict):
        return {key: to_number(item) for key, item in value.items()}
    if isinstance(value, list):
        return [to_number(item) for item in value]
    return value


def from_plain(record: dict[str, Any]) -> dict[str, Any]:
    """Undo `to_plain` for a record; strings at its top level stay strings."""
    return {key: item if isinstance(item, str) else to_number(item) for key, item in record.items()}


def dumps(value: Any) -> str:
    """Return one line of compact JSON in ASCII; lone surrogates are allowed."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def loads(text: str | bytes) -> Any:
    """Parse strict JSON; NaN and Infinity are rejected.

    Raises
    ------
    ValueError
        If the text is not JSON (or not UTF-8).
    """
    try:
        return json.loads(text, parse_constant=_refuse)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not JSON")


T = TypeVar("T")

_ADAPTERS: dict[type[Any], TypeAdapter[Any]] = {}


def to_json(record: Any) -> Any:
    """Turn dataclasses at any depth into mappings, sequences into lists.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Gap:
    ...     gap_mm: float
    ...     held_out_mm: float | None
    ...     share: float | None = None
    >>> to_json(Gap(0.3, None))
    {'gap_mm': 0.3, 'held_out_mm': None}
    """
    if is_dataclass(record) and not isinstance(record, type):
        values = ((field, getattr(record, field.name)) for field in fields(record))
        return {field.name: to_json(v) for field, v in values if not _left_out(field, v)}
    if isinstance(record, Mapping):
        return {key: to_json(value) for key, value in record.items()}
    if isinstance(record, Sequence) and not isinstance(record, str | bytes):
        return [to_json(item) for item in record]
    return record


def from_json(kind: type[T], data: Any) -> T:
    """Build a dataclass from the output of `to_json`.

    Parameters
    ----------
    kind : type
        A dataclass whose fields are annotated with plain types and other dataclasses.
    data : mapping
        Keys that `kind` lacks are ignored; strings such as "nan" become numbers
        where a number is expected.

    Raises
    ------
    ValueError
        If a field is missing or of another type; the message names the field.
    """
    try:
        record: T = _adapter(kind).validate_python(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ValueError(f"{kind.__name__}: {place}: {first['msg']}") from error
    return record


def _adapter(kind: type[T]) -> TypeAdapter[T]:
    """Return the validator of a dataclass; compiled once, which takes milliseconds."""
    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]


def _left_out(field: "Field[Any]", value: Any) -> bool:
    return value is None and field.default is None and field.default is not MISSING


DIGEST_LENGTH = 16


def digest(*parts: Any) -> str:
    """Return the digest of plain values.

    Parameters
    ----------
    *parts : JSON-able
        Mappings, sequences, numbers and text; keys may be integers. ``1`` and ``1.0``
        differ, ``{1: "a"}`` and ``{"1": "a"}`` do not.

    Raises
    ------
    InputError
        If a number is NaN or infinite.
    TypeError
        If a part cannot be written as JSON.

    Examples
    --------
    >>> digest({"E_fat": 0.01, "nodes": 2000}) == digest({"nodes": 2000, "E_fat": 0.01})
    True
    """
    plain = to_plain(parts, finite=True, where="digest")
    # json writes floats by repr, the shortest text that restores the same bits.
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("ascii")).hexdigest()[:DIGEST_LENGTH]


def array_digest(array: NDArray[Any]) -> str:
    """Return the digest of an array's shape, type and values; its memory layout is ignored."""
    little = array.astype(array.dtype.newbyteorder("<"), order="C", copy=False)
    state = hashlib.sha256(f"{little.dtype.str}{little.shape}".encode())
    state.update(np.ascontiguousarray(little).data)
    return state.hexdigest()[:DIGEST_LENGTH]


def file_digest(path: Path | str) -> str:
    """Return the digest of a file's bytes, or of the names and bytes of all files in a folder.

    Hidden files are ignored.

    Raises
    ------
    InputError
        If the path is missing or cannot be read.
    """
    path = Path(path)
    try:
        if not path.is_dir():
            return _bytes_of(path)[:DIGEST_LENGTH]
        files = sorted(p.relative_to(path) for p in path.rglob("*") if p.is_file())
        shown = (p for p in files if not any(part.startswith(".") for part in p.parts))
        return digest([[p.as_posix(), _bytes_of(path / p)] for p in shown])
    except OSError as error:
        raise InputError(
            f"Cannot read {path}: {error.strerror or error}. Check the path and its permissions."
        ) from error


def source_digest(folders: Iterable[Path | str]) -> str:
    """Return the digest of all ``.py`` files in some packages.

    Parameters
    ----------
    folders : iterable of path
        Folders of packages, wherever they are installed.
    """
    listed = [
        [Path(folder).name, file.relative_to(folder).as_posix(), _bytes_of(file)]
        for folder in folders
        for file in Path(folder).rglob("*.py")
    ]
    return digest(sorted(listed))


def _bytes_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


CHECKSUM_KEY = "checksum"
CHECKSUM_LENGTH = 16
SEAL_LENGTH = len(f'"{CHECKSUM_KEY}":""}}') + CHECKSUM_LENGTH


class ChecksumError(ValueError):
    """A record that differs from the one written."""


def seal(text: str) -> str:
    """Add a checksum to a JSON object, written without surrounding whitespace.

    Examples
    --------
    >>> seal('{"candidate":0}')
    '{"candidate":0,"checksum":"79360de56fb546c7"}'
    """
    body = text[:-1]
    comma = "" if body == "{" else ","
    return f"{body}{comma}{_seal_of(body.encode())}"


def unseal(line: str | bytes) -> tuple[dict[str, Any], bool]:
    """Read a record and verify its checksum.

    Returns
    -------
    record : dict
        Without its checksum.
    verified : bool
        False for a record of an earlier version, which has no checksum.

    Raises
    ------
    ValueError
        If the text is not a JSON object.
    ChecksumError
        If its checksum is wrong.
    """
    record = loads(line)
    if not isinstance(record, dict):
        raise ValueError("not an object")
    if CHECKSUM_KEY not in record:
        return record, False
    text = (line.encode() if isinstance(line, str) else line).strip()
    del record[CHECKSUM_KEY]
    if text[-SEAL_LENGTH:] != _seal_of(text[:-SEAL_LENGTH].removesuffix(b",")).encode():
        raise ChecksumError("its checksum is wrong, so something in it has changed")
    return record, True


def _seal_of(body: bytes) -> str:
    return f'"{CHECKSUM_KEY}":"{line_checksum(body)}"}}'


def line_checksum(body: bytes) -> str:
    """Return the checksum of a line without its last field and bracket."""
    return hashlib.sha256(body).hexdigest()[:CHECKSUM_LENGTH]
