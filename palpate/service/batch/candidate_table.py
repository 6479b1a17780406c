"""Tables of candidates from Python or a file, checked before any work starts."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palpate.service.extras import pyarrow
from palpate.service.study.spec import StudySpec
from palpate.storage.errors import InputError
from palpate.workers.input_files import read_text
from palpate.workers.mechanics.parameters import unknown_name

Genes = dict[str, float]


def read_table(path: Path) -> dict[str, Sequence[Any]]:
    """Read the columns of a table from a .csv or .parquet file.

    Raises
    ------
    InputError
        If it cannot be read, or the number of values in a line differs from the heading.
    """
    if path.suffix.lower() == ".parquet":
        table = pyarrow().parquet.read_table(path)
        return {name: table.column(name).to_pylist() for name in table.column_names}
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise InputError(f"There is no table {path}.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read as text: {error}.") from error
    lines = [line for line in csv.reader(text.lstrip("\ufeff").splitlines()) if line]
    if not lines:
        raise InputError(
            f"{path} is empty: expected a heading, such as E_fat_kpa, and rows of values."
        )
    heading = [name.strip() for name in lines[0]]
    for number, line in enumerate(lines[1:], 1):
        if len(line) != len(heading):
            raise InputError(
                f"{path}, row {number}: expected {len(heading)} values, found {len(line)}."
            )
    return {name: [line[i] for line in lines[1:]] for i, name in enumerate(heading)}


def candidates_of(spec: StudySpec, table: Any) -> list[Genes]:
    """Return the checked candidates of a table.

    Parameters
    ----------
    spec : StudySpec
    table : mapping, DataFrame, structured array, or sequence of mappings
        A mapping of columns of equal length; anything with ``columns`` such as a pandas table; a
        NumPy array with named fields; or one mapping for each row.

    Raises
    ------
    InputError
        If a value is not valid; the message names its row and column.
    """
    rows = list(_rows(table))
    if not rows:
        raise InputError("The table has no rows: there is nothing to evaluate.")
    parameters = spec.case.parameters
    for name in dict.fromkeys(name for row in rows for name in row):
        if name not in parameters.door_names:
            unused = spec.case.unused_parameter(name)
            reason = f" ({unused})" if unused else ""
            raise InputError(f"{unknown_name('column', name, parameters.door_names)}{reason}")
    return [_checked(spec, number, row) for number, row in enumerate(rows, 1)]


def _rows(table: Any) -> Iterable[Mapping[str, Any]]:
    names = getattr(getattr(table, "dtype", None), "names", None)
    if names:
        return [{name: row[name] for name in names} for row in np.atleast_1d(table)]
    if isinstance(table, Mapping):
        return _transposed({str(name): table[name] for name in table})
    if hasattr(table, "columns"):
        return _transposed({str(name): table[name] for name in table.columns})
    if isinstance(table, Iterable) and not isinstance(table, str | bytes):
        rows = list(table)
        if all(isinstance(row, Mapping) for row in rows):
            return rows
    raise InputError(
        "A table must be a mapping of columns, a list of mappings, a NumPy array with named "
        f"fields or a pandas table; found {type(table).__name__}."
    )


def _transposed(columns: Mapping[str, Any]) -> Iterable[Mapping[str, Any]]:
    values = {name: _values(column) for name, column in columns.items()}
    if len({len(column) for column in values.values()}) > 1:
        lengths = ", ".join(f"{name} {len(column)}" for name, column in values.items())
        raise InputError(f"All columns need the same number of values, found {lengths}.")
    return [dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True)]


def _values(column: Any) -> list[Any]:
    found = column.tolist() if hasattr(column, "tolist") else column
    return list(found) if isinstance(found, list | tuple | range) else [found]


def _checked(spec: StudySpec, number: int, row: Mapping[str, Any]) -> Genes:
    """Return a row as numbers, checked against its case."""
    found: Genes = {}
    for name, value in row.items():
        try:
            found[name] = float(value)
        except (TypeError, ValueError):
            raise InputError(f"Row {number}: {name} must be a number, found {value!r}.") from None
    try:
        spec.case.complete(spec.constants_of(found))
    except InputError as error:
        raise InputError(f"Row {number}: {error}") from None
    return found
