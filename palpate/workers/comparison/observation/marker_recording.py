"""Positions of markers over time, read from a table.

Positions at rest and under load are means over time windows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.comparison.observation.lost_markers import without_lost
from palpate.workers.comparison.observation.number_table import read_table

AXES = "xyz"
LENGTHS = {
    "mm": 1.0,
    "cm": 10.0,
    "m": 1000.0,
    "in": 25.4,
    "inch": 25.4,
    "um": 1e-3,
    "\u00b5m": 1e-3,
    "\u03bcm": 1e-3,
    "nm": 1e-6,
}
SECONDS = ("s", "sec")
# A marker visible in at most this fraction of a window's frames counts as not seen.
LEAST_VISIBLE = 0.2


@dataclass(frozen=True, eq=False)
class Recording:
    """Positions of markers in the frame of the cameras.

    Parameters
    ----------
    times_s : ndarray, shape (t,)
    places_mm : dict of str to ndarray, shape (t, 3)
        Positions by marker name; nan where a marker was not seen.
    name : str
        Name of the file, for messages.
    is_flat : bool
        Whether z was not recorded and is zero.
    """

    times_s: FloatArray
    places_mm: Mapping[str, FloatArray]
    name: str = "the recording"
    is_flat: bool = False

    def mean(self, name: str, window_s: tuple[float, float]) -> FloatArray:
        """Return the mean position of a marker in a time window, shape (3,).

        Negative times count from the end of the recording; a window from a negative time to zero
        lasts until the end.

        Raises
        ------
        InputError
            If the marker was not seen in the window.
        """
        last = float(self.times_s[-1])
        low, high = (last + s if s < 0 else s for s in window_s)
        if window_s[0] < 0 == window_s[1]:
            high = last
        inside = (self.times_s >= low) & (self.times_s <= high)
        lasts = f"the recording lasts from {self.times_s[0]:g} to {self.times_s[-1]:g} s"
        if not inside.any():
            raise InputError(f"{self.name} has no frame between {low:g} and {high:g} s; {lasts}.")
        places = self.places_mm[name][inside]
        visible = places[np.isfinite(places).all(axis=1)]
        seen, frames = visible.shape[0], places.shape[0]
        if seen <= LEAST_VISIBLE * frames:
            often = f"seen in only {seen} of {frames} frames" if seen else "not seen"
            raise InputError(
                f"{self.name}: the marker {name} was {often} between {low:g} and {high:g} "
                f"s; {lasts}. Omit the marker or the file, or choose other windows."
            )
        return np.asarray(visible.mean(axis=0))

    @property
    def notes(self) -> list[str]:
        """Return a sentence for each marker that is missing in some frames."""
        missing = {n: np.asarray(np.isnan(p).any(axis=1)) for n, p in self.places_mm.items()}
        return [
            f"The marker {name} is missing in {int(frames.sum())} of {len(frames)} frames of "
            f"{self.name}; these frames are ignored."
            for name, frames in missing.items()
            if frames.any()
        ]


def read_recording(
    path: Path,
    time: str,
    column: str,
    names: Sequence[str],
    mm_per_unit: float,
    z_is_optional: bool = False,
) -> Recording:
    """Read the positions of markers from a table.

    Parameters
    ----------
    path : Path
        Text file with the names of the columns above the rows; see `number_table`.
    time : str
        Name of the column with the time in s.
    column : str
        Name pattern of the other columns, which contains {marker} and {axis}.
    names : sequence of str
        The markers to read.
    mm_per_unit : float
        Length unit of the table, such as 1000 for m.
    z_is_optional : bool
        Whether all z columns may be absent, as for a sheet.

    Raises
    ------
    InputError
        If the file cannot be read, lacks a column, has no rows, or its times do not increase.
    """
    wanted = {n: [column.replace("{axis}", a).replace("{marker}", n) for a in AXES] for n in names}
    units = {c: _names_of(mm_per_unit) for three in wanted.values() for c in three}
    depths = [three[2] for three in wanted.values()] if z_is_optional else []
    needed = [time, *(c for c in units if c not in depths)]
    table = read_table(path, needed, depths, units={**units, time: SECONDS})
    _check_times(path, table[time], table.lines)
    is_flat = z_is_optional and not any(c in table.columns for c in depths)
    columns = {**dict.fromkeys(depths, np.zeros(len(table.lines))), **table.columns}
    places = {
        name: mm_per_unit * np.column_stack([columns[c] for c in three])
        for name, three in wanted.items()
    }
    return Recording(table[time], without_lost(places), str(path), is_flat)


def _names_of(mm_per_unit: float) -> list[str]:
    """Return the accepted names of a length unit."""
    return [name for name, mm in LENGTHS.items() if np.isclose(mm, mm_per_unit, rtol=1e-3)]


def _check_times(path: Path, times_s: FloatArray, lines: Sequence[int]) -> None:
    bad = np.flatnonzero(~np.isfinite(times_s))
    if len(bad):
        raise InputError(
            f"{path}, line {lines[bad[0]]}: the row has no time. Add the time, or remove the row."
        )
    late = np.flatnonzero(np.diff(times_s) <= 0)
    if len(late):
        at = int(late[0])
        raise InputError(
            f"{path}, line {lines[at + 1]}: the time {times_s[at + 1]:g} s follows "
            f"{times_s[at]:g} s on line {lines[at]}. Times must increase: sort the rows, and use "
            "a separate file for each recording."
        )
