"""Descriptions of the keys of a file, from the models that validate it."""

import inspect
import re
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel

_SECTION = re.compile(r"Parameters\n-+\n(?P<body>.*?)(?:\n\n[A-Z]\w+\n-+|\Z)", re.DOTALL)


def key_descriptions(model: type[BaseModel]) -> dict[str, str]:
    """Return the descriptions of the keys of a model by field name.

    They come from the fields, or from the "Parameters" sections of the class docstrings.
    """
    found: dict[str, str] = {}
    for cls in reversed(model.__mro__):
        if issubclass(cls, BaseModel):
            found |= _parameters(cls.__doc__ or "")
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


def _parameters(docstring: str) -> dict[str, str]:
    section = _SECTION.search(inspect.cleandoc(docstring))
    found: dict[str, str] = {}
    names: list[str] = []
    for line in section["body"].splitlines() if section else ():
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.split(" : ")[0].split(",")]
            continue
        for name in names:
            found[name] = f"{found.get(name, '')} {line.strip()}".strip()
    return found


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:].rstrip('.')}."
