"""YAML and JSON documents in which no key is repeated.

Both parsers keep the last of two equal keys and drop the first without a word, so a
force that was typed twice would be halved or doubled. Every file, upload and request is
parsed here.
"""

import json
from collections.abc import Hashable
from typing import Any

import yaml

from palpate.storage.errors import InputError

_MERGE = "tag:yaml.org,2002:merge"


class _RepeatedKeyError(Exception):
    """A key that is repeated, and where."""


class StrictLoader(yaml.SafeLoader):
    """Safe YAML that refuses a repeated key."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return the mapping of a node; see `yaml.SafeLoader`."""
        lines: dict[str, int] = {}
        for key_node, _ in node.value:
            if key_node.tag == _MERGE or not isinstance(key_node, yaml.ScalarNode):
                continue
            # 1 and "1" are one key to whatever reads them next.
            key, line = str(self.construct_object(key_node)), key_node.start_mark.line + 1
            if key in lines:
                raise _RepeatedKeyError(_repeated(key, f"in lines {lines[key]} and {line}"))
            lines[key] = line
        return super().construct_mapping(node, deep=deep)


def parse_yaml(text: str, where: str) -> Any:
    """Parse YAML, of which most JSON is a part.

    Parameters
    ----------
    text : str
    where : str
        Name of the document, for messages.

    Raises
    ------
    InputError
        If it is not YAML, or a key is repeated.
    """
    try:
        return yaml.load(text, StrictLoader)
    except _RepeatedKeyError as error:
        raise InputError(f"{where}: {error}") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # also of impossible dates
        raise InputError(f"{where} is not valid YAML: {error}.") from error
    except RecursionError:
        raise InputError(f"{where} is nested too deeply.") from None


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
        If it is not JSON, or a key is repeated.
    """
    try:
        return json.loads(text, object_pairs_hook=_object)
    except _RepeatedKeyError as error:
        raise InputError(f"{where}: {error}") from None
    except ValueError as error:
        raise InputError(f"{where} is not valid JSON: {error}.") from error
    except RecursionError:
        raise InputError(f"{where} is nested too deeply.") from None


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
