"""Tables of numbers exported by instruments and spreadsheets.

It supports UTF-8 and UTF-16; commas, semicolons, tabs and spaces between columns; decimal points
and decimal commas; comment lines and one row of units. Ambiguous numbers are rejected, and the
error names the line.
"""

import csv
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.input_files import MIB, read_bytes, reading

TABLE_BYTES = 256 * MIB
LONGEST = 100  # characters of a number
SHOWN = 200  # characters of a cell or a header in a message
COMMENTS = ("#", "%")
SEPARATORS = (",", ";", "\t", "|", None)
# Cells of a row of units.
UNITS = frozenset(
    ("", "-", "1", "s", "sec", "ms", "min", "mm", "cm", "m", "um", "\u00b5m", "\u03bcm", "nm")
) | {"in", "inch", "n", "kn", "mn", "px", "pixel", "deg", "rad", "hz"}
MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"})
INFINITE = frozenset({"inf", "infinity", "∞"})
# Spaces and apostrophes between groups of three digits.
_GROUPS = re.compile(r"(?<=\d)[ '\u2019\u00a0\u2009\u202f](?=\d{3}(?!\d))")
_NUMBER = (
    r"(?=[+-]?[.,]?\d)[+-]?(?:\d+|[1-9]\d{{0,2}}(?:{group}\d{{3}})+)?(?:{mark}\d*)?"
    r"(?:[eE][+-]?\d+)?"
)
_PLAIN = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_POINTS = re.compile(_NUMBER.format(group=",", mark=r"\."))
_COMMAS = re.compile(_NUMBER.format(group=r"\.", mark=","))


@dataclass(frozen=True)
class NumberTable:
    """Columns of numbers; nan where a cell is missing.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (t,)
    lines : tuple of int
        Line number of each row in the file, from 1.
    """

    columns: Mapping[str, FloatArray]
    lines: tuple[int, ...]

    def __getitem__(self, name: str) -> FloatArray:
        return self.columns[name]


Row = tuple[int, list[str]]


def read_table(
    path: Path,
    columns: Sequence[str],
    optional: Sequence[str] = (),
    units: Mapping[str, Collection[str]] | None = None,
) -> NumberTable:
    """Read columns of numbers from a text file.

    Parameters
    ----------
    path : Path
    columns, optional : sequence of str
        Required columns, and columns that may be absent.
    units : mapping of str to collection of str, optional
        Units accepted for each column in a row of units below the header.

    Raises
    ------
    InputError
        If the file cannot be read, lacks a column, has no rows, repeats a column, or contains a row
        whose length differs from the header or a cell that is not a number.
    """
    with reading(path, "a table"):
        header, rows = _split(path, _lines(path), columns)
        _check_header(path, header, columns)
        rows = _without_units(path, header, rows, units or {})
        if not rows:
            raise InputError(f"{path} has no rows; expected column names, then numbers.")
        for line, cells in rows:
            if len(cells) != len(header):
                raise InputError(_wrong_length(path, line, cells, header))
        wanted = [name for name in (*columns, *optional) if name in header]
        texts = {n: [(line, _tidy(c[header.index(n)])) for line, c in rows] for n in wanted}
        values = _numbers(path, texts)
        return NumberTable(values, tuple(line for line, _ in rows))


def _lines(path: Path) -> list[str]:
    try:
        raw = read_bytes(path, TABLE_BYTES)
    except OSError as error:
        raise InputError(f"{path} cannot be read as a table: {error.strerror}.") from error
    return _decoded(path, raw).splitlines()


def _decoded(path: Path, raw: bytes) -> str:
    """Return the text of a file in UTF-8 or UTF-16, with or without a byte order mark."""
    encoding = "utf-8-sig"
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif raw[1:2] == b"\0" or raw[:1] == b"\0":
        encoding = "utf-16-le" if raw[1:2] == b"\0" else "utf-16-be"
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path} is not text in {encoding.upper().removesuffix('-SIG')}: {error.reason} at "
            f"byte {error.start}. Export the table as CSV in UTF-8."
        ) from error
    if "\0" in text:
        raise InputError(f"{path} is not a text file. Export the table as CSV in UTF-8.")
    return text


def _split(path: Path, lines: Sequence[str], columns: Sequence[str]) -> tuple[list[str], list[Row]]:
    """Return the names of the columns and the rows below them.

    The header is the first line that names all columns, or else the first line that is not a
    comment; it determines the separator of the columns.
    """
    filled = [(n, text) for n, text in enumerate(lines, start=1) if text.strip(" \t,;|\"'")]
    body = [pair for pair in filled if not _is_comment(pair[1])]
    if not body:
        raise InputError(f"{path} has no rows; expected column names, then numbers.")
    named = [pair for pair in filled if columns[0] in pair[1]]
    candidates = [
        (line, mark, _cells(text.strip().lstrip("#% "), mark))
        for line, text in [body[0], *named]
        for mark in SEPARATORS
    ]
    # Ties go to the first line that is not a comment.
    first, mark, header = max(candidates, key=lambda found: len(set(columns) & set(found[2])))
    return header, [(line, _cells(text, mark)) for line, text in body if line > first]


def _is_comment(text: str) -> bool:
    return text.lstrip().startswith(COMMENTS)


def _cells(text: str, mark: str | None) -> list[str]:
    if mark is None:
        return text.split()
    cells = next(csv.reader([text], delimiter=mark, skipinitialspace=True), [])
    return [cell.strip() for cell in cells]


def _check_header(path: Path, header: Sequence[str], columns: Sequence[str]) -> None:
    missing = [c for c in columns if c not in header]
    if missing:
        raise InputError(
            f"{path} lacks the columns {', '.join(missing[:3])}; its columns are "
            f"{_short(', '.join(header))}."
        )
    repeated = sorted({name for name in header if name and header.count(name) > 1})
    if repeated:
        raise InputError(
            f"{path} has the column {repeated[0]} {header.count(repeated[0])} times. Name each "
            "column once."
        )


def _without_units(
    path: Path, header: list[str], rows: list[Row], units: Mapping[str, Collection[str]]
) -> list[Row]:
    """Return the rows without the row of units at the top, if any, after checking its units."""
    if not rows or any(_is_number(cell) for cell in rows[0][1]) or not any(rows[0][1]):
        return rows
    line, cells = rows[0]
    unit_row = [cell.strip("[]() ").lower() for cell in cells]
    if len(cells) != len(header) or not set(unit_row) <= UNITS:
        return rows
    for name, unit in zip(header, unit_row, strict=True):
        if unit and name in units and unit not in units[name]:
            raise InputError(
                f"{path}, line {line}: the column {name} is in {unit}, expected "
                f"{' or '.join(units[name])}. Convert it, or set mm_per_unit."
            )
    return rows[1:]


def _is_number(cell: str) -> bool:
    text = _tidy(cell)
    return bool(text) and bool(_POINTS.fullmatch(text) or _COMMAS.fullmatch(text))


def _wrong_length(path: Path, line: int, cells: Sequence[str], header: Sequence[str]) -> str:
    found = f"{path}, line {line}: {len(cells)} cells below a header of {len(header)} columns."
    if len(cells) > len(header):
        return (
            f"{found} This happens with decimal commas in comma-separated files: export with "
            "semicolons between the columns, or with decimal points."
        )
    return f"{found} Complete the row, or remove it."


def _tidy(cell: str) -> str:
    """Return a cell without digit grouping and with an ordinary minus sign."""
    return _GROUPS.sub("", cell.strip().strip("\"'").replace("\u2212", "-").strip())


def _numbers(path: Path, texts: Mapping[str, list[tuple[int, str]]]) -> dict[str, FloatArray]:
    """Return columns as numbers, using the one convention that fits all their cells."""
    cells = [(name, line, t) for name, column in texts.items() for line, t in column]
    for name, line, text in cells:
        if len(text) > LONGEST:
            raise InputError(
                f"{path}, line {line}: the cell in column {name} has {len(text)} characters, "
                "expected a number."
            )
    digits = [cell for cell in cells if _special(cell[2]) is None]
    mark, group = _convention(path, digits)
    return {
        name: np.array([_value(text, mark, group) for _, text in column], np.float64)
        for name, column in texts.items()
    }


def _special(text: str) -> float | None:
    """Return the value of a word for a missing or infinite number; None for other text."""
    word = text.lower()
    if word in MISSING:
        return float("nan")
    if word.lstrip("+-") in INFINITE:
        return -float("inf") if word.startswith("-") else float("inf")
    return None


def _value(text: str, mark: str, group: str) -> float:
    special = _special(text)
    return float(text.replace(group, "").replace(mark, ".")) if special is None else special


def _convention(path: Path, cells: Sequence[tuple[str, int, str]]) -> tuple[str, str]:
    """Return the decimal mark and the thousands separator."""
    texts = [text for *_, text in cells]
    if all(_PLAIN.fullmatch(text) for text in texts):
        return ".", ","
    points, commas = ([bool(p.fullmatch(t)) for t in texts] for p in (_POINTS, _COMMAS))
    if all(points) and not all(commas):
        return ".", ","
    if all(commas) and not all(points):
        return ",", "."
    raise InputError(_unreadable(path, cells, points, commas))


def _unreadable(
    path: Path,
    cells: Sequence[tuple[str, int, str]],
    points: Sequence[bool],
    commas: Sequence[bool],
) -> str:
    """Return the error for cells that fit no convention, both, or different conventions."""
    pairs: Iterator[tuple[tuple[str, int, str], bool, bool]] = zip(
        cells, points, commas, strict=True
    )
    known = list(pairs)
    for (name, line, text), point, comma in known:
        if not point and not comma:
            return (
                f"{path}, line {line}: {_short(text)!r} in column {name} is not a number. "
                "Expected a number, or an empty cell or nan where nothing was measured."
            )
    if all(points):
        name, line, text = next(c for c in cells if "," in c[2])
        return (
            f"{path}, line {line}: {_short(text)!r} in column {name} may be a decimal "
            "comma or a thousands separator. Export with decimal points and without separators."
        )
    by_point = next(c for c, point, comma in known if point and not comma)
    by_comma = next(c for c, point, comma in known if comma and not point)
    return (
        f"{path} mixes decimal points and commas: {_short(by_point[2])!r} on line {by_point[1]}, "
        f"{_short(by_comma[2])!r} on line {by_comma[1]}. Export with one decimal mark."
    )


def _short(text: str) -> str:
    return text if len(text) <= SHOWN else f"{text[:SHOWN]} ..."
