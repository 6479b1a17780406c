"""Tables of displacements of many points, some components of which may be missing.

Image correlation with one camera cannot measure motion along its axis, and any correlation
loses some points: an absent column, an empty cell or nan means that a component was not
measured.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.comparison.observation.number_table import NumberTable, read_table
from palpate.workers.organs.specimen.spec import SpecimenSpec

POINT = ("x_mm", "y_mm", "z_mm")
MOVE = ("ux_mm", "uy_mm", "uz_mm")
# Largest difference between positions of a point in two files, in mm.
SAME = 1e-6
UNITS = dict.fromkeys((*POINT, *MOVE), ("mm",))


@dataclass(frozen=True, eq=False)
class FieldTables:
    """The points of a field in all recordings of all states.

    Parameters
    ----------
    points_mm : ndarray, shape (k, 3)
    repeats_mm : tuple of ndarray, shape (r, k, 3)
        Displacements of each state; nan where a component was not measured.
    notes : tuple of str
        Notes on components that are not compared.
    """

    points_mm: FloatArray
    repeats_mm: tuple[FloatArray, ...]
    notes: tuple[str, ...]

    @property
    def measured(self) -> BoolArray:
        """Mask of components that were measured in all recordings, shape (k, 3)."""
        return np.asarray(np.isfinite(np.concatenate(self.repeats_mm)).all(axis=0))


def read_field(spec: SpecimenSpec, folder: Path) -> FieldTables:
    """Read the tables of a field.

    Parameters
    ----------
    spec : SpecimenSpec
    folder : Path
        Folder to which the names of its files are relative.

    Raises
    ------
    InputError
        If a table cannot be read, has no displacements, or lists other points.
    """
    points: FloatArray | None = None
    is_sheet = spec.body.sheet is not None
    repeats = []
    for state in spec.states:
        moved = []
        for file in state.files:
            path = folder / file
            wanted, optional = (POINT[:2], (POINT[2], *MOVE)) if is_sheet else (POINT, MOVE)
            table = read_table(path, wanted, optional, UNITS)
            found = _columns(table, POINT)
            if is_sheet and POINT[2] not in table.columns:
                found[:, 2] = 0.0
            points = found if points is None else points
            _check_points(path, table, found, points)
            moved.append(_displacements(path, table))
        repeats.append(np.stack(moved))
    if points is None:
        raise AssertionError("an experiment has states")
    found_field = FieldTables(points, tuple(repeats), ())
    return FieldTables(points, found_field.repeats_mm, _notes(found_field.measured))


def _check_points(path: Path, table: NumberTable, found: FloatArray, first: FloatArray) -> None:
    bad = np.flatnonzero(~np.isfinite(found).all(axis=1))
    if len(bad):
        raise InputError(
            f"{path}, line {table.lines[bad[0]]}: the position of a point is incomplete. "
            f"Points need {', '.join(POINT)} as finite numbers."
        )
    if found.shape != first.shape or np.abs(found - first).max() > SAME:
        raise InputError(
            f"{path} lists different points from the files before it. All recordings must list the "
            "same points at rest, in the same order."
        )


def _displacements(path: Path, table: NumberTable) -> FloatArray:
    """Return displacements, nan for components that were not measured, shape (k, 3)."""
    if not set(MOVE) & set(table.columns):
        raise InputError(f"{path} lacks the columns {', '.join(MOVE)}: at least one is needed.")
    moved = _columns(table, MOVE)
    bad = np.flatnonzero(np.isinf(moved).any(axis=1))
    if len(bad):
        raise InputError(
            f"{path}, line {table.lines[bad[0]]}: a displacement is infinite. Leave the cell "
            "empty where nothing was measured."
        )
    return moved


def _columns(table: NumberTable, names: Sequence[str]) -> FloatArray:
    empty = np.full(len(table.lines), np.nan)
    return np.column_stack([table.columns.get(name, empty) for name in names])


def _notes(measured: BoolArray) -> tuple[str, ...]:
    """Return notes on components that are not compared."""
    absent = [name for name, column in zip(MOVE, measured.T, strict=True) if not column.any()]
    rest = measured[:, measured.any(axis=0)]
    single = int((~rest).any(axis=1).sum())
    notes = []
    if absent:
        notes.append(f"{' and '.join(absent)} was not measured and is not compared.")
    if single:
        notes.append(
            f"{single} of {len(measured)} points lack a component in some recording; missing "
            "components are not compared."
        )
    return tuple(notes)
