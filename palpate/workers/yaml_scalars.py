"""Scalars of YAML as they are written: numbers of YAML 1.2's core schema, and their lines.

PyYAML reads YAML 1.1, where 060 is 48, 1:30 is 90 and yes is true. `core_resolvers` and
`core_number` read 1.2: decimal numbers, with 1e3, and 0x1f. A spelling that the two versions read
as different numbers raises `UnclearValueError`, as do others that people read as numbers in
different ways: underscores, base 60 and decimal commas.

`WrittenValues` finds the line on which a value is written.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import yaml

_TAG = "tag:yaml.org,2002:"
_DECIMAL = re.compile(r"[-+]?[0-9]+")
_HEX = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_BOOL = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")
_OCTAL = re.compile(r"^0o[0-7]+$")
_DIGITS = "0123456789"

Resolvers = dict[str, list[tuple[str, re.Pattern[str]]]]


class UnclearValueError(Exception):
    """A value that can be read in several ways, with its place.

    Parameters
    ----------
    reason : str
    mark : yaml.Mark
        Start of the value.
    """

    def __init__(self, reason: str, mark: yaml.Mark) -> None:
        super().__init__(reason)
        self.mark = mark

    def message(self, text: str) -> str:
        """Return the message, with the key before the value in the text of the document."""
        before = text[: self.mark.index].rpartition("\n")[2]
        keys = re.findall(r"""([^\s{\[,:"']+)["']?\s*:\s""", before)
        return f"{keys[-1]}: {self}" if keys else str(self)


def core_resolvers(older: Mapping[str, Any]) -> Resolvers:
    """Return the tags of plain scalars in YAML 1.2, from PyYAML's table by first character.

    Every spelling of a number in YAML 1.1 keeps its tag, so that `core_number` can refuse it.
    Dates and ``=`` are text.
    """
    omitted = {f"{_TAG}{kind}" for kind in ("timestamp", "value", "bool")}
    table: Resolvers = {
        first: [(tag, pattern) for tag, pattern in pairs if tag not in omitted]
        for first, pairs in older.items()
    }
    added = (
        ("bool", _BOOL, "tTfF"),
        ("int", re.compile(rf"^(?:{_DECIMAL.pattern})$"), f"-+{_DIGITS}"),
        ("int", _OCTAL, "0"),
        ("float", re.compile(rf"^(?:{_FLOAT.pattern})$"), f"-+.{_DIGITS}"),
    )
    for kind, pattern, firsts in added:
        for first in firsts:
            table.setdefault(first, []).append((f"{_TAG}{kind}", pattern))
    return table


def core_number(node: yaml.ScalarNode, older: Callable[[], float]) -> int | float:
    """Return the number of a scalar.

    Parameters
    ----------
    node : yaml.ScalarNode
    older : callable
        Returns its value in YAML 1.1.

    Raises
    ------
    UnclearValueError
        If YAML 1.1 and 1.2 differ, or a float cannot hold it.
    """
    text = node.value
    if _DECIMAL.fullmatch(text):
        number: int | float = int(text)
        digits = text.lstrip("+-")
        octal = int(digits, 8) if digits[0] == "0" and not set(digits) & set("89") else abs(number)
        if octal != abs(number):
            raise _unclear(node, f"is {number} in decimal or {octal} in octal", number)
        return float(number) if node.tag == f"{_TAG}float" else number
    if _HEX.fullmatch(text):
        return int(text, 16)
    if _NOT_FINITE.fullmatch(text):
        return older()
    if _FLOAT.fullmatch(text):
        number = float(text)
        mantissa = re.split("[eE]", text)[0]
        if abs(number) == float("inf") or (number == 0 and mantissa.strip("+-0.")):
            raise _unclear(node, "is out of the range of numbers (1e-300 to 1e300)")
        return number
    if _OCTAL.match(text):
        return _refuse(node, "is octal", lambda: int(text[2:], 8))
    if ":" in text:
        return _refuse(node, "is a text or a number in base 60", older)
    return _refuse(node, "has underscores" if "_" in text else "is not decimal", older)


def _refuse(node: yaml.ScalarNode, reason: str, older: Callable[[], float]) -> int:
    try:
        number = older()
    except ValueError:  # such as 0b_
        raise _unclear(node, reason) from None
    raise _unclear(node, reason, number)


def _unclear(
    node: yaml.ScalarNode, reason: str, number: float | None = None
) -> "UnclearValueError":
    text, line = node.value[:40], node.start_mark.line + 1
    instead = "" if number is None else f"{number}, or "
    quoted = f'write {instead}"{text}" in quotes if it is a text'
    return UnclearValueError(f"{text} on line {line} {reason}: {quoted}", node.start_mark)


def refuse_decimal_commas(node: yaml.MappingNode) -> None:
    """Raise UnclearValueError if a number in braces has a comma: ``{force_n: 5,0}``.

    YAML reads such a comma as the end of the value, and the digits after it as another key.
    """
    for (_, value), (key, empty) in pairwise(node.value):
        if not all(isinstance(part, yaml.ScalarNode) for part in (value, key, empty)):
            continue
        adjacent = value.end_mark.index + 1 == key.start_mark.index
        if adjacent and not empty.value and _DECIMAL.fullmatch(value.value) and key.value.isdigit():
            found, line = f"{value.value},{key.value}", value.start_mark.line + 1
            instead = number_to_write(found)
            raise UnclearValueError(
                f"{found} on line {line} has a comma: {instead}", key.start_mark
            )


def number_to_write(text: str) -> str:
    """Return what to write instead of a text that was meant as a number, or "".

    Examples
    --------
    >>> number_to_write("5,0"), number_to_write("1,500"), number_to_write("1 000")
    ('write 5.0', 'write 1500, or 1.5 if the comma is a decimal one', 'write 1000')
    >>> number_to_write("60 N"), number_to_write("many")
    ('give the number alone, in the unit of the key', '')
    """
    text = text.strip()
    if re.fullmatch(r"[-+]?\d+,\d+", text):
        decimal = text.replace(",", ".")
        if re.fullmatch(r"[-+]?[1-9]\d{0,2},\d{3}", text):
            return (
                f"write {text.replace(',', '')}, or {float(decimal):g} if the comma is a decimal "
                "one"
            )
        return f"write {decimal}"
    if re.fullmatch(r"[-+]?\d{1,3}([ '_\u00a0\u2009\u202f]\d{3})+(\.\d+)?", text):
        return f"write {re.sub(r'[^-+.0-9]', '', text)}"
    with_unit = re.fullmatch(rf"({_FLOAT.pattern})\s*[^\W\d]\S*", text)
    return "give the number alone, in the unit of the key" if with_unit else ""


class WrittenValues:
    """The values of a YAML document as they are written.

    Parameters
    ----------
    text : str
        A valid document, or "".
    loader : type
        Loader of the document.
    """

    def __init__(self, text: str, loader: Any) -> None:
        self._text, self._loader = text, loader

    @cached_property
    def _root(self) -> Any:
        return yaml.compose(self._text, self._loader) if self._text else None

    def line(self, path: Sequence[str | int]) -> int | None:
        """Return the line, from 1, of the value at a path of keys and numbers in lists."""
        nodes = list(self._nodes(path))
        return nodes[-1].start_mark.line + 1 if len(nodes) == len(path) + 1 else None

    def source(self, path: Sequence[str | int]) -> str:
        """Return the text of the value at a path, or "" if there is none."""
        nodes = list(self._nodes(path))
        if len(nodes) != len(path) + 1:
            return ""
        return self._text[nodes[-1].start_mark.index : nodes[-1].end_mark.index]

    def _nodes(self, path: Sequence[str | int]) -> Iterator[Any]:
        """Yield the nodes along a path, up to the first part that is missing."""
        node = self._root
        for part in (*path, None):
            if node is None:
                return
            yield node
            if isinstance(node, yaml.MappingNode):
                keys = [value for key, value in node.value if key.value == str(part)]
                node = keys[0] if keys else None
            elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
                node = node.value[part] if part < len(node.value) else None
            else:
                node = None


def is_text_in_older_yaml(source: str) -> bool:
    """Return True for a number of YAML 1.2 that is text in YAML 1.1, such as 1e3 and 08."""
    older: Any = yaml.SafeLoader("")
    tag = older.resolve(yaml.ScalarNode, source, (True, False))
    return bool(tag == f"{_TAG}str" and (_FLOAT.fullmatch(source) or _DECIMAL.fullmatch(source)))
