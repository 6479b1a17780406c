"""Read the places of markers over time from a table.

The place of a marker at rest and under load are means over windows of time.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from storage.errors import InputError
from storage.values import FloatArray

AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Recording:
    """Hold places of markers in the frame of the cameras.

    Parameters
    ----------
    times_s : ndarray, shape (t,)
    places_mm : dict of str to ndarray, shape (t, 3)
        nan where a marker was not seen.
    """

    times_s: FloatArray
    places_mm: Mapping[str, FloatArray]

    def mean(self, name: str, window_s: tuple[float, float]) -> FloatArray:
        """Return the mean place of a marker in a window of time, shape (3,).

        Times below zero count from the end of the recording; so does the end of a window
        that begins there and ends at zero.

        Raises
        ------
        InputError
            If it was not seen there.
        """
        last = float(self.times_s[-1])
        low, high = (last + s if s < 0 else s for s in window_s)
        if window_s[0] < 0 == window_s[1]:
            high = last
        inside = (self.times_s >= low) & (self.times_s <= high)
        visible = self.places_mm[name][inside]
        visible = visible[np.isfinite(visible).all(axis=1)]
        if not len(visible):
            raise InputError(
                f"The marker {name} was not seen between {low:g} and {high:g} s; the recording "
                f"lasts from {self.times_s[0]:g} to {self.times_s[-1]:g} s."
            )
        return np.asarray(visible.mean(axis=0))


def read_recording(
    path: Path, time: str, column: str, names: Sequence[str], mm_per_unit: float
) -> Recording:
    """Read the markers of a table.

    Parameters
    ----------
    path : Path
        Comma-separated, names of the columns in the first line.
    time : str
        The column of the time in s.
    column : str
        Names of the other columns, with {marker} and {axis} in it.
    names : sequence of str
        The markers that are wanted.
    mm_per_unit : float
        1000 for a table in m.

    Raises
    ------
    InputError
        If the file cannot be read, or lacks a column or any row.
    """
    wanted = {n: [column.format(marker=n, axis=a) for a in AXES] for n in names}
    table = read_table(path, [time, *(c for three in wanted.values() for c in three)])
    places = {
        name: mm_per_unit * np.column_stack([table[c] for c in three])
        for name, three in wanted.items()
    }
    return Recording(table[time], places)


def read_table(path: Path, columns: Sequence[str]) -> dict[str, FloatArray]:
    """Read columns of numbers of a comma-separated file; an empty cell is nan.

    Raises
    ------
    InputError
        If the file cannot be read, lacks a column or any row, or holds words.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} cannot be read as a table: {error}.") from error
    if not rows:
        raise InputError(f"{path} holds no rows: expected names of columns, then numbers.")
    missing = [c for c in columns if c not in rows[0]]
    if missing:
        raise InputError(
            f"{path} lacks the columns {', '.join(missing[:3])}; it has {', '.join(rows[0])}."
        )
    try:
        return {c: np.array([float(row[c] or "nan") for row in rows]) for c in columns}
    except ValueError as error:
        raise InputError(f"{path} holds something else than numbers: {error}.") from error
