"""The results of a batch of candidates, as arrays, tables and files."""

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from palpate.service.extras import frame_type, pyarrow
from palpate.storage.backends.atomic import explained, replacing, write_file
from palpate.storage.errors import InputError
from palpate.storage.records.best_candidate import score_of
from palpate.storage.records.record import EvaluationRecord

if TYPE_CHECKING:
    from pandas import DataFrame

SCORES = ("gsf", "jc", "mhd_mm")


@dataclass(frozen=True, eq=False)
class Evaluations:
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
        found: dict[str, NDArray[Any]] = {
            name: np.array([r.genes.get(name, math.nan) for r in self.records], np.float64)
            for name in names
        }
        found["status"] = np.array([str(r.status) for r in self.records])
        found["reason"] = np.array([r.reason for r in self.records])
        for name in SCORES:
            scores = [math.nan if r.score is None else float(r.score[name]) for r in self.records]
            found[name] = np.array(scores, np.float64)
        if self.objective not in SCORES:
            ranks = [score_of(r) for r in self.records]
            found[self.objective] = np.array([r if r < math.inf else math.nan for r in ranks])
        found["seconds"] = np.array([sum(r.seconds.values()) for r in self.records], np.float64)
        found["reused"] = np.array([r.reused for r in self.records])
        return found

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
