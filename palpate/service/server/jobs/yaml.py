"""Untrusted YAML and JSON: no aliases, no deep nesting, no paths.

Aliases can expand a kilobyte of text to gigabytes, and deep nesting exceeds the recursion limit
of the parser; no study needs either.
"""

import re
from collections.abc import Iterator
from typing import Any

import yaml

from palpate.storage.errors import InputError
from palpate.workers.documents import is_too_deep, parse_yaml
from palpate.workers.input_files import reason_of

MOST_EVENTS = 50_000
DEEPEST = 40
TOO_LARGE = "{} is nested too deeply or too long for a study."
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_LEADS_OUT = re.compile(
    r"^\s*(/|~|[A-Za-z]:[\\/]|\\\\|[A-Za-z][A-Za-z0-9+.-]*://)|(^|[\\/])\.\.([\\/]|$)"
)


def parsed_text(text: str, where: str) -> Any:
    """Parse YAML, which includes JSON.

    Raises
    ------
    InputError
        If it is not valid YAML, or uses features that are not accepted.
    """
    try:
        _check_events(text, where)
    except yaml.YAMLError as error:
        if is_too_deep(error):
            raise InputError(TOO_LARGE.format(where)) from None
        raise InputError(f"{where} is not valid YAML: {reason_of(error)}") from error
    return parse_yaml(text, where)


def _check_events(text: str, where: str) -> None:
    depth = 0
    for count, event in enumerate(yaml.parse(text, _LOADER)):
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise InputError(f"{where} uses anchors or aliases (& and *): write the values out.")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > DEEPEST or count > MOST_EVENTS:
            raise InputError(TOO_LARGE.format(where))


def refuse_paths(data: Any, where: str) -> None:
    """Refuse strings that are absolute paths, URLs, or paths outside their folder.

    Raises
    ------
    InputError
    """
    for key, value in texts(data):
        if _LEADS_OUT.search(value) or "\0" in value:
            raise InputError(
                f"{where}: {key} is {value[:60]!r}, which points outside the service. Name an "
                "upload, FOLDER/FILE, or a volume in the store."
            )


def texts(data: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield all strings in plain values, with the dotted names of their keys."""
    if isinstance(data, str):
        yield key, data
    elif isinstance(data, dict):
        for name, value in data.items():
            yield from texts(value, f"{key}.{name}".lstrip("."))
    elif isinstance(data, list | tuple):
        for number, value in enumerate(data):
            yield from texts(value, f"{key}[{number}]")


def depth_of(data: Any) -> int:
    """Return the nesting depth of plain values, without recursion."""
    deepest, level = 0, [data]
    while level:
        deepest += 1
        if deepest > 2 * DEEPEST:
            break
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner.extend(value.values())
            elif isinstance(value, list):
                inner.extend(value)
        level = inner
    return deepest
