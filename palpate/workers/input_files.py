"""Safe access to input files and their YAML or JSON, with messages for users.

A path may refer to an endless pipe or a device, a file may name other files, and parsers raise
almost any exception on damaged files. Readers use

- `read_bytes` and `read_text`, which open regular files of a limited size,
- `named_by` for each file that another file names,
- `reading`, which converts any exception to one message,
- `parse_yaml` and `parse_json`, which return plain values without repeated keys.

Ordinary parsers keep the last of two equal keys and silently drop the first, so a force that is
given twice could be wrong without anyone noticing. Every file, upload and request is parsed here,
into dict, list, str, int, float, bool and None; other YAML tags are refused, and dates are read as
text. Numbers are those of YAML 1.2, see `yaml_scalars`. Nesting, whole numbers and the expanded
size of aliases are limited. `dump_yaml` writes what `parse_yaml` reads.
"""

import errno
import json
import logging
import os
import re
import stat
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import yaml
from yaml.representer import Representer, SafeRepresenter

from palpate.storage.errors import InputError, PalpateError
from palpate.storage.read_only import FrozenDict, FrozenList
from palpate.workers.yaml_scalars import (
    UnclearValueError,
    core_number,
    core_resolvers,
    refuse_decimal_commas,
)

_log = logging.getLogger(__name__)

MIB = 2**20
TEXT_BYTES = 16 * MIB
"""Maximum size of a document: a study, a case, an experiment or a label file."""
_LONGEST_REASON = 300
"""Maximum number of characters of a library's message that are shown."""
_allowed: ContextVar[Path | None] = ContextVar("folder that files may be in", default=None)


@contextmanager
def confined_to(folder: Path) -> Iterator[None]:
    """Refuse input files outside a folder, within the context."""
    token = _allowed.set(folder.resolve())
    try:
        yield
    finally:
        _allowed.reset(token)


def named_by(path: Path, name: str) -> Path:
    """Return the path of a file that another file names, relative to its folder.

    Parameters
    ----------
    path : Path
        File that contains the name.
    name : str

    Raises
    ------
    InputError
        If it is outside the folder that input is confined to, or is not a valid path.
    """
    if "\0" in name:
        raise InputError(f"{path} names the file {name[:60]!r}, which is not a valid file name.")
    named = path.parent / name
    check_allowed(named, f"{path} names {name[:200]!r}, which")
    return named


def check_allowed(path: Path, what: str = "") -> None:
    """Raise InputError if a path is outside the folder that input is confined to."""
    folder = _allowed.get()
    if folder is not None and not path.resolve().is_relative_to(folder):
        raise InputError(
            f"{what or path.name} is outside the uploaded folder. Upload all files of one input "
            "to one folder, and refer to them by name."
        )


def check_regular(path: Path) -> None:
    """Raise InputError if a path exists and is a pipe, a socket or a device.

    Opening a pipe waits for a writer, and a device may never end.
    """
    check_allowed(path)
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # the reader reports missing files
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(
            f"{path} is a pipe or a device; a file was expected. Write the data to a file and give "
            "its path."
        )


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Read the content of a regular file.

    Raises
    ------
    InputError
        If the path is not a regular file, or the file is larger than `most_bytes`.
    OSError
        If the file cannot be read.
    """
    check_regular(path)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    with path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise InputError(
            f"{path} is larger than {most_bytes / MIB:g} MiB, the limit for such a file. Check "
            "that it is the right one."
        )
    return content


def read_text(path: Path, encoding: str = "utf-8-sig", most_bytes: int = TEXT_BYTES) -> str:
    """Read the text of a document; see `read_bytes`.

    Raises
    ------
    UnicodeDecodeError
        If the content is not text in that encoding.
    """
    return read_bytes(path, most_bytes).decode(encoding).replace("\r\n", "\n").replace("\r", "\n")


@contextmanager
def reading(path: Path | str, kind: str) -> Iterator[None]:
    """Convert any exception raised while reading and checking input to `InputError`.

    Parameters
    ----------
    path : Path or str
        Name of the file, for the message.
    kind : str
        Kind of file, such as ``"NRRD"`` or ``"an experiment"``.
    """
    try:
        yield
    except PalpateError:
        raise
    except MemoryError as error:
        _log.debug("Reading %s has failed.", path, exc_info=True)
        raise InputError(
            f"{path} needs more memory than this machine has. Check its size and resolution, or "
            "give coarser data."
        ) from error
    except RecursionError as error:
        raise InputError(f"{path} is nested too deeply to be {kind}.") from error
    except Exception as error:  # parsers raise almost anything on damaged input
        _log.debug("Reading %s has failed.", path, exc_info=True)
        if isinstance(error, OSError) and error.strerror:  # decompressors raise some without
            raise InputError(f"{path} cannot be read as {kind}: {error.strerror}.") from error
        raise InputError(
            f"{path} cannot be read as {kind}: {reason_of(error)}. It is damaged, cut short or "
            "misnamed; copy or export it again."
        ) from error


def reason_of(error: BaseException) -> str:
    """Return the message of an exception, shortened to one line, or else its type."""
    try:
        text = " ".join(str(error).split())
    except ValueError:  # it contains a number with too many digits
        text = ""
    text = text if len(text) <= _LONGEST_REASON else f"{text[:_LONGEST_REASON]} ..."
    return (text or type(error).__name__).rstrip(".")


DEEPEST_NESTING = 100
MOST_NODES = 2_000_000
"""Maximum number of values in a document with expanded aliases."""
LARGEST_INT = 2**63 - 1
"""Largest whole number; seeds of blind cases have as many bits."""
_TAG = "tag:yaml.org,2002:"
_MERGE = f"{_TAG}merge"
_PLAIN = {f"{_TAG}{kind}" for kind in ("null", "bool", "int", "float", "str", "seq", "map")}
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster with libyaml


class _RepeatedKeyError(Exception):
    """A repeated key, with its location."""


class StrictLoader(_Loader):
    """Safe YAML 1.2 loader for plain values that refuses repeated keys and unclear numbers."""

    yaml_constructors = {  # noqa: RUF012 - as in its base class
        tag: make for tag, make in _Loader.yaml_constructors.items() if tag is None or tag in _PLAIN
    }
    yaml_implicit_resolvers = core_resolvers(_Loader.yaml_implicit_resolvers)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return the mapping of a node; see `yaml.SafeLoader`."""
        refuse_decimal_commas(node)
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

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        """Return the number of a node; see `core_number`."""
        older = self.construct_yaml_int if node.tag.endswith("int") else self.construct_yaml_float
        number = core_number(node, lambda: older(node))
        if isinstance(number, int) and abs(number) > LARGEST_INT:
            raise ValueError(f"a whole number on line {node.start_mark.line + 1} is too large")
        return number


for _kind in ("int", "float"):
    StrictLoader.add_constructor(f"{_TAG}{_kind}", StrictLoader.construct_number)


class _Dumper(yaml.SafeDumper):
    """Safe YAML dumper that quotes text which YAML 1.1 or 1.2 reads as something else."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - as in its base class
        first: [
            *yaml.SafeDumper.yaml_implicit_resolvers.get(first, []),
            *StrictLoader.yaml_implicit_resolvers.get(first, []),
        ]
        for first in StrictLoader.yaml_implicit_resolvers
    }


# Also for yaml.safe_dump and yaml.dump of a caller, who may write a part of a study.
for _representer in (SafeRepresenter, Representer):
    _representer.add_representer(FrozenDict, SafeRepresenter.represent_dict)
    _representer.add_representer(FrozenList, SafeRepresenter.represent_list)


def dump_yaml(data: Any) -> str:
    """Return plain values as YAML, with keys in their order."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
    return text


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
        _check_document_size(text, where)
        return yaml.load(text, StrictLoader)
    except _RepeatedKeyError as error:
        raise InputError(f"{where}: {error}") from None
    except UnclearValueError as error:
        raise InputError(f"{where}: {error.message(text)}.") from None
    except (yaml.YAMLError, ValueError, OverflowError, TypeError) as error:
        if is_too_deep(error):
            raise InputError(f"{where} is nested too deeply.") from None
        raise InputError(f"{where} is not valid YAML: {yaml_problem(error, text)}.") from error
    except RecursionError:
        raise InputError(f"{where} is nested too deeply.") from None


def yaml_problem(error: Exception, text: str) -> str:
    """Return one line about an error in YAML: the problem, its line and, for a tab, the remedy."""
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return reason_of(error)
    line = mark.line + 1
    written = text[mark.index :] if mark.index < len(text) else ""
    if re.match(r" *\t", written) or re.match(r"\s*\t", _line_of(text, mark.line)):
        return f"line {line} is indented with a tab. Replace each tab by blanks"
    parts = (getattr(error, "context", None), getattr(error, "problem", None) or reason_of(error))
    return f"{': '.join(part for part in parts if part)}, on line {line}"


def _line_of(text: str, line: int) -> str:
    lines = text.split("\n")
    return lines[line] if line < len(lines) else ""


def is_too_deep(error: Exception) -> bool:
    """Return True if the error is the depth limit of newer versions of libyaml."""
    return "maximum nesting depth" in str(error)


def _check_document_size(text: str, where: str) -> None:
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
        if len(open_nodes) > DEEPEST_NESTING:
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
        data = json.loads(text, object_pairs_hook=_json_object, parse_int=_whole_number)
        if re.search(rb"\\u[dD][89a-fA-F]", text.encode() if isinstance(text, str) else text):
            json.dumps(data, ensure_ascii=False).encode()  # half a character cannot be
        return data
    except _RepeatedKeyError as error:
        raise InputError(f"{where}: {error}") from None
    except ValueError as error:
        raise InputError(f"{where} is not valid JSON: {error}.") from error
    except RecursionError:
        raise InputError(f"{where} is nested too deeply.") from None


def _whole_number(digits: str) -> int:
    number = int(digits)
    if abs(number) > LARGEST_INT:
        raise ValueError(f"the whole number {digits[:24]} is too large")
    return number


def _json_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            beside = ", ".join(dict.fromkeys(k for k, _ in pairs if k != key))
            raise _RepeatedKeyError(_repeated(key, f"in an object with {beside or 'no other key'}"))
        found[key] = value
    return found


def _repeated(key: str, place: str) -> str:
    return f"the key {key!r} is repeated {place}. Keep one of them."
