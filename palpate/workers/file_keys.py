"""Keys of files: their descriptions, messages about missing ones, and their old names.

`key_descriptions` and `described_schema` describe the keys from the models that validate a file.
The message about a required key that is missing or empty is the ``description`` of its field.

Files may still use old names of keys. A record in a store keeps its original names, because its
digest depends on them; `with_current_names` reads both, and `with_recorded_names` writes the old
ones.
"""

import inspect
import logging
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cache
from types import MappingProxyType, NoneType
from typing import Any, Final, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

_SECTION = re.compile(r"Parameters\n-+\n(?P<body>.*?)(?:\n\n[A-Z]\w+\n-+|\Z)", re.DOTALL)


def key_descriptions(model: type[BaseModel]) -> dict[str, str]:
    """Return the descriptions of the keys of a model by field name.

    They come from the fields, or from the "Parameters" sections of the class docstrings.
    """
    found: dict[str, str] = {}
    for cls in reversed(model.__mro__):
        if issubclass(cls, BaseModel):
            found |= _described_parameters(cls.__doc__ or "")
    own = {name: field.description for name, field in model.model_fields.items()}
    said = {name: _sentence(text) for name, text in own.items() if text and name not in found}
    return {name: text for name, text in (found | said).items() if name in own}


def described_schema(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON schema of a model, with a description of every key."""
    schema = model.model_json_schema()
    named = {one.__name__: one for one in models_in(model)}
    definitions = schema.get("$defs", {})
    for name, part in [(model.__name__, schema), *definitions.items()]:
        meanings = key_descriptions(named[name]) if name in named else {}
        for key, entry in part.get("properties", {}).items():
            if key in meanings:
                entry["description"] = meanings[key]
    return schema


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in an annotation, outer ones first."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        yield annotation
        for field in annotation.model_fields.values():
            yield from models_in(field.annotation)
    for part in get_args(annotation):
        yield from models_in(part)


def _described_parameters(docstring: str) -> dict[str, str]:
    section = _SECTION.search(inspect.cleandoc(docstring))
    descriptions: dict[str, str] = {}
    names: list[str] = []
    for line in section["body"].splitlines() if section else ():
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.split(" : ")[0].split(",")]
            continue
        for name in names:
            descriptions[name] = f"{descriptions.get(name, '')} {line.strip()}".strip()
    return descriptions


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:].rstrip('.')}."


MISSING = "missing"
Pairs = tuple[tuple[str, ...], ...]
"""Groups of keys of which exactly one must be given."""


def missing_key(text: str) -> PydanticCustomError:
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


_log = logging.getLogger(__name__)

OLD_DIAGNOSIS_KEYS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "model.nu": "constants.nu",
        "wall.kx_kpa_per_mm": "wall.wall_hold_x_kpa_per_mm",
        "wall.ky_kpa_per_mm": "wall.wall_hold_y_kpa_per_mm",
        "scans.loads[].file": "scans.loads[].volume",
        "constants.eta_kpa": "constants.eta_fat_kpa",
    }
)
"""Keys of a diagnosis, by their old names; ``[]`` means each entry of a list."""

SAME_FIBRES: Final = {"eta_glandular_kpa": "eta_fat_kpa"}
"""Key added to ``eta_fat_kpa`` if both tissues share one value, formerly ``eta_kpa``."""


def with_current_names(data: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Return a diagnosis with the current names of its keys.

    Parameters
    ----------
    data : mapping
        A diagnosis as read from YAML or JSON; it is not modified.
    where : str, optional
        Name of the file, for a log message about each old name; omit it for records in a store.
    """
    tree = _copied(data)
    for old, new in OLD_DIAGNOSIS_KEYS.items():
        if not _moved(tree, old, new):
            continue
        text = new
        if old == "constants.eta_kpa":
            tree["constants"] |= SAME_FIBRES
            text = "constants.eta_fat_kpa, with eta_glandular_kpa: eta_fat_kpa"
        if where:
            _log_old_name(where, old, text)
    return tree


def with_recorded_names(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a diagnosis with the key names used in its stored record."""
    tree = _copied(data)
    constants = tree["constants"]
    same = all(constants.get(key) == value for key, value in SAME_FIBRES.items())
    for old, new in OLD_DIAGNOSIS_KEYS.items():
        if old != "constants.eta_kpa" or same:
            _moved(tree, new, old)
    if same:
        for key in SAME_FIBRES:
            del constants[key]
    return tree


@cache
def _log_old_name(where: str, old: str, text: str) -> None:
    """Log a note once."""
    _log.warning("%s: %s is now called %s. The old name is still read.", where, old, text)


def _copied(value: Any) -> Any:
    """Return a copy of nested mappings and lists; other values are kept."""
    if isinstance(value, Mapping):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list) else value


def _moved(tree: dict[str, Any], source: str, target: str) -> bool:
    """Move values between paths; return False if the source is empty or the target is not."""
    *above, name = source.split(".")
    *inside, new = target.split(".")
    moved = False
    for place in _places(tree, above):
        if name not in place:
            continue
        goal = place if inside == above else tree.setdefault(inside[0], {})
        if isinstance(goal, dict) and new not in goal:
            goal[new] = place.pop(name)
            moved = True
    return moved


def _places(value: Any, path: list[str]) -> Iterator[dict[Any, Any]]:
    """Yield the mappings at a path."""
    if not path:
        if isinstance(value, dict):
            yield value
        return
    name, *rest = path
    inside = value.get(name.removesuffix("[]")) if isinstance(value, dict) else None
    if not name.endswith("[]"):
        yield from _places(inside, rest)
        return
    for item in inside if isinstance(inside, list) else ():
        yield from _places(item, rest)
