"""Conversion of frozen dataclasses to JSON and back, with one schema for both directions.

A field without a default is always written, None as null. A field whose default is None is
omitted while it is None, so that a record contains only the quantities that were computed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

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
