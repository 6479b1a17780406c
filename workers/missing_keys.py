"""Keys that a file leaves empty: which of them are required, and what belongs there.

The text for a key is the ``description`` of its field.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from types import NoneType
from typing import Any, get_args

from pydantic import BaseModel
from pydantic_core import PydanticCustomError

MISSING = "missing"


def missing(text: str) -> PydanticCustomError:
    """Return the error of a model in which something required is left out."""
    return PydanticCustomError(MISSING, "{text}", {"text": text})


def without_empty_keys(model: type[BaseModel], data: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return `data` without the empty keys that have no meaning as null.

    An empty optional key then has its default, and an empty required key is missing.
    """
    nullable = _nullable_fields(model)
    return {key: v for key, v in data.items() if v is not None or key in nullable}


def is_missing(error: Mapping[str, Any]) -> bool:
    """Return whether an error of pydantic is a required key that is left out or empty."""
    return error["type"] == MISSING or error["input"] is None


def missing_text(error: Mapping[str, Any], model: type[BaseModel]) -> str:
    """Return one line for a required key that is left out or empty."""
    text = error.get("ctx", {}).get("text")
    if text is not None:
        return str(text)
    about = description_at(model, error["loc"])
    return f"this key is missing{f': {about}' if about else ''}"


def description_at(model: type[BaseModel], loc: Sequence[str | int]) -> str:
    """Return the description of the last field on a path that has one, or "".

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
    about, inside = "", model
    for key in loc:
        field = inside.model_fields.get(key) if isinstance(key, str) else None
        if field is not None:
            about = field.description or ""
            inside = _model_in(field.annotation) or BaseModel
    return about


@cache
def _nullable_fields(model: type[BaseModel]) -> frozenset[str]:
    fields = model.model_fields.items()
    return frozenset(name for name, field in fields if NoneType in get_args(field.annotation))


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """Return the record that a type holds, such as that of ``tuple[Record, ...] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    found = (_model_in(part) for part in get_args(annotation))
    return next((model for model in found if model is not None), None)
