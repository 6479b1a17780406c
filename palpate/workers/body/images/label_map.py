"""Maps from labels to tissues, as users write them in YAML, JSON or an option."""

import re
from collections.abc import Mapping
from typing import Any

from palpate.storage.errors import InputError
from palpate.workers.body.images.labels import tissue_named

FORMS = "a mapping such as {0: air, 1: fat} or {Adipose: fat}, or a file that names labels"


def label_map(given: Any) -> Any:
    """Return a map from label numbers or names to tissue names; a path is returned unchanged.

    Numbers may be strings, as keys are in JSON.

    Raises
    ------
    ValueError
        If it is invalid, or names a label twice.
    """
    if given is None or isinstance(given, str):
        return given
    if not isinstance(given, Mapping):
        raise ValueError(f"expected {FORMS}; found {given!r}")
    tissues: dict[int | str, str] = {}
    for key, value in given.items():
        label = _label(key)
        if label in tissues:
            raise ValueError(f"label {label} is named twice: keep one")
        tissues[label] = _tissue(label, value)
    return tissues


def _label(key: Any) -> int | str:
    if isinstance(key, int) and not isinstance(key, bool):
        return key
    text = str(key).strip()
    return int(text) if re.fullmatch(r"-?\d+", text) else text


def _tissue(label: int | str, value: Any) -> str:
    if isinstance(value, int) and isinstance(label, str):
        raise ValueError(f"write {{{value}: {label}}}, not {{{label}: {value}}}")
    if not isinstance(value, str):
        raise ValueError(f"{label}: expected a tissue, such as fat; found {value!r}")
    try:
        return tissue_named(value).name.lower()
    except InputError as error:
        raise ValueError(f"{label}: {error}") from None
