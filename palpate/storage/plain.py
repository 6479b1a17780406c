"""Conversion of values to JSON and back that preserves infinities.

JSON has no infinity and no NaN, but a perfect score is ``-inf`` and a failed
one ``inf``. They are written as the strings "-inf", "inf" and "nan", and read back
as numbers wherever a record expects a number.
"""

import json
import math
from collections.abc import Mapping, Sequence, Set
from enum import Enum
from typing import Any

import numpy as np

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
