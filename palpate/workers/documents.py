"""YAML and JSON documents of plain values without repeated keys.

Both parsers keep the last of two equal keys and silently drop the first, so a force that is given
twice could be wrong without anyone noticing. Every file, upload and request is parsed here, into
dict, list, str, int, float, bool and None; other YAML tags are refused, and dates are read as text.
Nesting, whole numbers and the expanded size of aliases are limited.
"""

import json
from collections.abc import Hashable
from typing import Any

import yaml

from palpate.storage.errors import InputError

DEEPEST = 100
MOST_NODES = 2_000_000
"""Maximum number of values in a document with expanded aliases."""
LARGEST_INT = 2**63 - 1
"""Largest whole number; seeds of blind cases have as many bits."""
_TAG = "tag:yaml.org,2002:"
_MERGE, _DATE = f"{_TAG}merge", f"{_TAG}timestamp"
_PLAIN = {f"{_TAG}{kind}" for kind in ("null", "bool", "int", "float", "str", "seq", "map")}
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster with libyaml


class _RepeatedKeyError(Exception):
    """A repeated key, with its location."""


class StrictLoader(_Loader):
    """Safe YAML loader for plain values that refuses repeated keys."""

    yaml_constructors = {  # noqa: RUF012 - as in its base class
        tag: make for tag, make in _Loader.yaml_constructors.items() if tag is None or tag in _PLAIN
    }
    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, pattern) for tag, pattern in resolvers if tag != _DATE]
        for first, resolvers in _Loader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return the mapping of a node; see `yaml.SafeLoader`."""
        lines: dict[str, int] = {}
        for key_node, _ in node.value:
            if key_node.tag == _MERGE or not isinstance(key_node, yaml.ScalarNode):
                continue
            # 1 and "1" are the same key for later readers.
            key, line = str(self.construct_object(key_node)), key_node.start_mark.line + 1
            if key in lines:
                raise _RepeatedKeyError(_repeated(key, f"on lines {lines[key]} and {line}"))
            lines[key] = line
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep=deep)
        return mapping

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Return the whole number of a node; see `yaml.SafeLoader`."""
        number: int = super().construct_yaml_int(node)
        if abs(number) > LARGEST_INT:
            raise ValueError(f"a whole number on line {node.start_mark.line + 1} is too large")
        return number


StrictLoader.add_constructor(f"{_TAG}int", StrictLoader.construct_yaml_int)


def parse_yaml(text: str, where: str) -> Any:
    """Parse YAML, which includes most JSON.

    Parameters
    ----------
    text : str
    where : str
        Name of the document, for messages.

    Raises
    ------
    InputError
        If the text is not YAML, or a key is repeated.
    """
    try:
        _check_size(text, where)
        return yaml.load(text, StrictLoader)
    except _RepeatedKeyError as error:
        raise InputError(f"{where}: {error}") from None
    except (yaml.YAMLError, ValueError, OverflowError, TypeError) as error:
        if is_too_deep(error):
            raise InputError(f"{where} is nested too deeply.") from None
        raise InputError(f"{where} is not valid YAML: {error}.") from error
    except RecursionError:
        raise InputError(f"{where} is nested too deeply.") from None


def is_too_deep(error: Exception) -> bool:
    """Return True if the error is the depth limit of newer versions of libyaml."""
    return "maximum nesting depth" in str(error)


def _check_size(text: str, where: str) -> None:
    """Raise InputError for a document nested too deeply, or too large when expanded."""
    sizes: dict[str, int] = {}
    open_nodes: list[tuple[str | None, int]] = []
    nodes = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append((event.anchor, nodes))
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_nodes.pop()
            if anchor is not None:
                sizes[anchor] = nodes - before
        elif isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _ in open_nodes):
                raise InputError(f"{where}: the value {event.anchor!r} contains itself.")
            nodes += sizes.get(event.anchor or "", 0)
        nodes += 1
        if len(open_nodes) > DEEPEST:
            raise InputError(f"{where} is nested too deeply.")
        if nodes > MOST_NODES:
            raise InputError(
                f"{where} contains more than {MOST_NODES:,} values after its aliases (*) are "
                "expanded. Write the values themselves, without aliases."
            )


def parse_json(text: str | bytes, where: str) -> Any:
    """Parse JSON.

    Parameters
    ----------
    text : str or bytes
    where : str
        Name of the document, for messages.

    Raises
    ------
    InputError
        If the text is not JSON, or a key is repeated.
    """
    try:
        return json.loads(text, object_pairs_hook=_object, parse_int=_whole)
    except _RepeatedKeyError as error:
        raise InputError(f"{where}: {error}") from None
    except ValueError as error:
        raise InputError(f"{where} is not valid JSON: {error}.") from error
    except RecursionError:
        raise InputError(f"{where} is nested too deeply.") from None


def _whole(digits: str) -> int:
    number = int(digits)
    if abs(number) > LARGEST_INT:
        raise ValueError(f"the whole number {digits[:24]} is too large")
    return number


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            beside = ", ".join(dict.fromkeys(k for k, _ in pairs if k != key))
            raise _RepeatedKeyError(_repeated(key, f"in an object with {beside or 'no other key'}"))
        found[key] = value
    return found


def _repeated(key: str, place: str) -> str:
    return f"the key {key!r} is repeated {place}. Keep one of them."
