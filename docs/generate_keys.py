"""The reference of the files' keys: name, type, default and description, from the models."""

import inspect
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from palpate.workers.file_keys import key_descriptions

HEAD = """# Keys of the files

Every key of a study, a diagnosis and a bench experiment, generated from the models that check the
files; `palpate schema` prints them as JSON schema. A key that is not listed is refused.
`palpate new` writes a file of each kind with comments;
`palpate parameters` lists the constants and effects that a study may hold or search.
"""


def keys_page() -> str:
    """Return the keys of every kind of file as Markdown."""
    from palpate.service.study.study_keys import study_of
    from palpate.workers.organs.organ_plugins import organ_names, resolve
    from palpate.workers.organs.source_registry import file_keys

    models = {name: resolve(keys) for name, keys in file_keys().items()}
    files = (
        *((f"A study of a {name}", study_of(name)) for name in organ_names()),
        ("A diagnosis of scans", models["diagnosis"]),
        ("A bench experiment", models["experiment"]),
    )
    lines = [HEAD]
    for title, model in files:
        lines += [f"## {title}", "", "| key | value | default | meaning |", "|---|---|---|---|"]
        lines += [*_rows(model, ""), ""]
    return "\n".join(lines)


def _rows(model: type[BaseModel], prefix: str) -> Iterator[str]:
    described = key_descriptions(model)
    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        inner = _model_in(field.annotation)
        default = (
            "required"
            if field.is_required()
            else _text(field.get_default(call_default_factory=True))
        )
        kind = "" if inner else _kind(field.annotation)
        yield f"| `{key}` | {kind} | {default} | {_cell(described.get(name, ''))} |"
        if inner is not None:
            yield from _rows(inner, f"{key}{_many(field.annotation)}.")


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model that a value, or each entry of a list or mapping, consists of."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return annotation
    found = (_model_in(part) for part in get_args(annotation) if part is not type(None))
    return next((model for model in found if model is not None), None)


def _cell(text: str) -> str:
    """Return a text with Markdown's quotes that fits a cell of a table."""
    return text.replace("``", "`").replace("|", "\\|")


def _many(annotation: Any) -> str:
    return "[]" if get_origin(annotation) in (list, tuple) else ""


def _kind(annotation: Any) -> str:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(parts[0])
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in parts)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_kind(p) for p in parts if p is not type(None)))
    if origin in (list, tuple):
        inside = dict.fromkeys(_kind(part) for part in parts if part is not Ellipsis)
        return f"list of {' or '.join(inside)}"
    if origin is not None:
        return "mapping"
    return {str: "text", int: "whole number", float: "number", bool: "true or false"}.get(
        annotation, "text"
    )


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, BaseModel):
        return ""
    return f"`{value}`" if not isinstance(value, bool) else f"`{str(value).lower()}`"
