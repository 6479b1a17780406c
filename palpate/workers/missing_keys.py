"""Messages about required keys that are missing or empty.

The text for a key is the ``description`` of its field.
"""

from collections.abc import Collection, Mapping, Sequence
from functools import cache
from types import NoneType
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

MISSING = "missing"
Pairs = tuple[tuple[str, ...], ...]
"""Groups of keys of which exactly one must be given."""


def missing(text: str) -> PydanticCustomError:
    """Return the validation error for a missing required key."""
    return PydanticCustomError(MISSING, "{text}", {"text": text})


def without_empty_keys(model: type[BaseModel], data: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return `data` without empty keys for which null has no meaning.

    An empty optional key then takes its default, and an empty required key counts as missing.
    """
    nullable = _nullable_fields(model)
    return {key: v for key, v in data.items() if v is not None or key in nullable}


def is_missing(error: Mapping[str, Any]) -> bool:
    """Return True if a pydantic error is about a missing or empty required key."""
    return error["type"] == MISSING or error["input"] is None


def missing_text(error: Mapping[str, Any], model: type[BaseModel]) -> str:
    """Return one line about a missing or empty required key."""
    text = error.get("ctx", {}).get("text")
    if text is not None:
        return str(text)
    about = description_at(model, error["loc"])
    return f"this key is missing{f': {about}' if about else ''}"


def description_at(model: type[BaseModel], loc: Sequence[str | int]) -> str:
    """Return the last description of a field on a path, or "".

    Examples
    --------
    >>> from pydantic import Field
    >>> class Scan(BaseModel):
    ...     file: str = Field(description="the label volume")
    >>> class Case(BaseModel):
    ...     scans: tuple[Scan, ...]
    >>> description_at(Case, ("scans", 0, "file"))
    'the label volume'
    """
    return _walk(model, loc)[1]


def _record_at(model: type[BaseModel], loc: Sequence[str | int]) -> type[BaseModel]:
    return _walk(model, loc)[0]


def _walk(model: type[BaseModel], loc: Sequence[str | int]) -> tuple[type[BaseModel], str]:
    """Return the record at the end of a path, and the last description on it."""
    about = ""
    for key in loc:
        field = model.model_fields.get(key) if isinstance(key, str) else None
        if field is not None:
            about = field.description or ""
            model = _model_in(field.annotation) or BaseModel
    return model, about


def missing_pairs(
    model: type[BaseModel], data: Mapping[Any, Any], empty: Collection[str] = ()
) -> list[str]:
    """Return a line for each group of `model.exactly_one` without a key in `data`.

    `empty` holds the keys without a value in the file, which the user probably meant to fill in.
    """
    pairs: Pairs = getattr(model, "exactly_one", ())
    return [
        _none_of(model, sorted(keys, key=lambda key: key not in empty), empty)
        for keys in pairs
        if all(data.get(key) is None for key in keys)
    ]


def errors_with_pairs(error: ValidationError, model: type[BaseModel]) -> list[Mapping[str, Any]]:
    """Return pydantic's errors, plus the missing groups of records that are otherwise incomplete.

    Pydantic checks these groups only if all fields of a record are present, but users want one
    complete list. A list that is too short only because its items are invalid is not an error.
    """
    found = _with_short_lists([dict(e) for e in error.errors(include_url=False)])
    places = [e["loc"] for e in found]
    kept = [e for e in found if not (e["type"] == "too_short" and _has_more(e["loc"], places))]
    for e in [e for e in kept if e["type"] == MISSING and "ctx" not in e]:
        place, data = e["loc"][:-1], e["input"]
        empty = [key for key, value in data.items() if value is None]
        new = [_missing_at(place, t) for t in missing_pairs(_record_at(model, place), data, empty)]
        kept += [line for line in new if line not in kept]
    return kept


def _with_short_lists(errors: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Replace the missing items of a list by one error about its length."""
    found: dict[Any, Mapping[str, Any]] = {}
    for number, e in enumerate(errors):
        if e["type"] != MISSING or not isinstance(e["input"], list | tuple):
            found[number] = e
            continue
        *place, item = e["loc"]
        text = f"expected {item + 1} values in brackets"
        found[tuple(place)] = {**e, "type": "short_list", "loc": tuple(place), "msg": text}
    return list(found.values())


def _missing_at(place: tuple[Any, ...], text: str) -> Mapping[str, Any]:
    return {"type": MISSING, "loc": place, "input": None, "ctx": {"text": text}}


def _has_more(place: tuple[Any, ...], places: Sequence[tuple[Any, ...]]) -> bool:
    return any(len(p) > len(place) and p[: len(place)] == place for p in places)


def one_of(keys: Sequence[str]) -> str:
    """Return the instruction to give exactly one of several keys.

    Examples
    --------
    >>> one_of(["box_mm", "mesh", "sheet"])
    'give exactly one of box_mm, mesh and sheet'
    """
    return f"give exactly one of {', '.join(keys[:-1])} and {keys[-1]}"


def _none_of(model: type[BaseModel], keys: Sequence[str], empty: Collection[str]) -> str:
    """Return a message about the first of `keys` if only that one is empty, or else about all."""
    fields, (key, *others) = model.model_fields, keys
    if key in empty and not any(other in empty for other in others):
        return f"{key} is missing: {fields[key].description or key}; or give {' or '.join(others)}"
    about = [f"{k} is {text}" for k in keys if (text := fields[k].description)]
    explained = f": {', '.join(about)}" if about else ""
    return f"{one_of(keys)}, found {'neither' if len(keys) == 2 else 'none'}{explained}"


@cache
def _nullable_fields(model: type[BaseModel]) -> frozenset[str]:
    fields = model.model_fields.items()
    return frozenset(name for name, field in fields if NoneType in get_args(field.annotation))


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model in a type, such as ``Record`` in ``tuple[Record, ...] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    found = (_model_in(part) for part in get_args(annotation))
    return next((model for model in found if model is not None), None)
