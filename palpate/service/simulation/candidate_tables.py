"""Tables of candidates, and the tables of their results.

Candidates come from Python, from a file, or from a design that fills the box of a search evenly.
They are checked before any work starts. The results of a batch are arrays, tables and files.
"""

import csv
import io
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from palpate.service.installed_packages import frame_type, pyarrow
from palpate.service.search.search_interface import FloatArray, Space
from palpate.service.study.study_keys import StudySpec
from palpate.storage.backends.atomic_files import explained, replacing, write_file
from palpate.storage.best_candidate import score_of
from palpate.storage.errors import InputError
from palpate.storage.journal_records import EvaluationRecord
from palpate.storage.read_only import ReadOnly
from palpate.workers.input_files import read_text
from palpate.workers.mechanics.model_parameters import unknown_name

if TYPE_CHECKING:
    from pandas import DataFrame

Genes = dict[str, float]
DESIGNS: dict[str, Callable[..., Any]] = {
    "sobol": qmc.Sobol,
    "halton": qmc.Halton,
    "latin-hypercube": qmc.LatinHypercube,
}


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
    genes: Genes = {}
    for name, value in row.items():
        try:
            genes[name] = float(value)
        except (TypeError, ValueError):
            raise InputError(f"Row {number}: {name} must be a number, found {value!r}.") from None
    try:
        spec.case.complete(spec.constants_of(genes))
    except InputError as error:
        raise InputError(f"Row {number}: {error}") from None
    return genes


SCORES = ("gsf", "jc", "mhd_mm")


@dataclass(frozen=True, eq=False)
class Evaluations(ReadOnly):
    """A table of evaluated candidates, one row for each request, in order.

    Parameters
    ----------
    records : tuple of EvaluationRecord
        The ending of each candidate; `candidate` is its row, from 0.
    objective : str
        The score by which candidates are ranked.
    """

    records: tuple[EvaluationRecord, ...]
    objective: str = "gsf"

    def __len__(self) -> int:
        return len(self.records)

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {status}" for status, count in self.counts.items())
        return f"<Evaluations of {len(self)} candidates: {counts}>"

    def __getitem__(self, column: str) -> NDArray[Any]:
        return self.columns[column]

    @property
    def counts(self) -> dict[str, int]:
        """Number of candidates by status."""
        status = [str(record.status) for record in self.records]
        return {one: status.count(one) for one in dict.fromkeys(status)}

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """The table as arrays of equal length.

        The constants as given; ``status`` (done, diverged, crashed or lost) and ``reason``;
        ``gsf``, ``jc``, ``mhd_mm`` and any other score that the study optimises, NaN without a
        score; ``seconds`` of computation; ``reused``, whether the store already had the evaluation.
        """
        names = dict.fromkeys(name for record in self.records for name in record.genes)
        table: dict[str, NDArray[Any]] = {
            name: np.array([r.genes.get(name, math.nan) for r in self.records], np.float64)
            for name in names
        }
        table["status"] = np.array([str(r.status) for r in self.records])
        table["reason"] = np.array([r.reason for r in self.records])
        for name in SCORES:
            scores = [math.nan if r.score is None else float(r.score[name]) for r in self.records]
            table[name] = np.array(scores, np.float64)
        if self.objective not in SCORES:
            ranks = [score_of(r) for r in self.records]
            table[self.objective] = np.array([r if r < math.inf else math.nan for r in ranks])
        table["seconds"] = np.array([sum(r.seconds.values()) for r in self.records], np.float64)
        table["reused"] = np.array([r.reused for r in self.records])
        return table

    @property
    def best(self) -> EvaluationRecord | None:
        """The candidate with the best score; None if none has a score."""
        scored = [r for r in self.records if score_of(r) < math.inf]
        return min(scored, key=score_of, default=None)

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield each row as plain values by column."""
        columns = {name: values.tolist() for name, values in self.columns.items()}
        for row in zip(*columns.values(), strict=True):
            yield dict(zip(columns, row, strict=True))

    def to_frame(self) -> "DataFrame":
        """Return the table as a pandas table.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        frame: DataFrame = frame_type()(self.columns)
        return frame

    def save(self, path: str | Path) -> Path:
        """Write the table to a .csv or .parquet file and return its path.

        Raises
        ------
        InputError
            If the suffix is neither, or pyarrow is missing for Parquet.
        StoreError
            If the file cannot be written.
        """
        path = Path(path)
        check_table_suffix(path)
        if path.suffix.lower() == ".parquet":
            arrow = pyarrow()
            with explained(path), replacing(path) as temporary:
                arrow.parquet.write_table(arrow.table(self.columns), temporary)
            return path
        text = io.StringIO()
        writer = csv.DictWriter(text, list(self.columns), lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows())
        with explained(path):
            write_file(path, text.getvalue().encode())
        return path


def check_table_suffix(path: Path) -> None:
    """Raise an error for a path to which a table cannot be written.

    Raises
    ------
    InputError
        If its suffix is neither .csv nor .parquet, or its folder or pyarrow is missing.
    """
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(
            f"{path}: {path.suffix or 'no suffix'} is not supported; use .csv or .parquet."
        )
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it.")
    if path.suffix.lower() == ".parquet":
        pyarrow()


def design(space: Space, kind: str = "sobol", n: int = 64, seed: int = 1) -> FloatArray:
    """Return points that fill a box evenly.

    Parameters
    ----------
    space : Space
        A box with d parameters.
    kind : {"sobol", "halton", "latin-hypercube"}
        All are scrambled; a Sobol design is balanced where `n` is a power of two.
    n : int
        Number of points, >= 1.
    seed : int
        The same seed gives the same points.

    Returns
    -------
    ndarray, shape (n, d)
        In the units of the space.

    Raises
    ------
    InputError
        If the design is unknown, or `n` or `seed` is too small.

    Examples
    --------
    >>> space = Space.from_bounds({"E_fat_kpa": (5, 20), "nu": (0.45, 0.49)})
    >>> points = design(space, "sobol", 8)
    >>> points.shape, bool((points >= space.lower).all() and (points <= space.upper).all())
    ((8, 2), True)
    """
    if kind not in DESIGNS:
        raise InputError(f"There is no design {kind!r}: use one of {', '.join(DESIGNS)}.")
    if n < 1:
        raise InputError(f"A design needs at least one point, found {n}.")
    if seed < 0:
        raise InputError(f"The seed of a design must not be negative, found {seed}.")
    sampler = DESIGNS[kind](space.dimension, rng=np.random.default_rng(seed))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # raised if n is not a power of two
        return space.from_unit(sampler.random(n))


def design_columns(
    space: Space, kind: str = "sobol", n: int = 64, seed: int = 1
) -> dict[str, FloatArray]:
    """Return the points of a `design`, shape (n,), by parameter name."""
    return dict(zip(space.names, design(space, kind, n, seed).T, strict=True))
