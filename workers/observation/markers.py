r"""What markers on a body have done: their displacements, and how well these are known.

The place of a marker at rest and under load are means over windows of time. Displacements
are turned from the frame of the cameras into that of the body by the rigid motion that fits
the places at rest best (W. Kabsch, Acta Cryst. A 32 (1976) 922; B. K. P. Horn, J. Opt. Soc.
Am. A 4 (1987) 629).

Component c of the displacement of marker i in repeat r scatters as

.. math:: d_{rci} = \mu_{ci} + a_{rc} + e_{rci}, \qquad a \sim N(0, \sigma_a^2),
          \quad e \sim N(0, \sigma_e^2):

what all markers of a recording share, and what each has for itself. Repeats tell both, by
the analysis of variance; what they share with each other they cannot tell.
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
    """Places of markers in the frame of the cameras.

    Parameters
    ----------
    times_s : ndarray, shape (t,)
    places_mm : dict of str to ndarray, shape (t, 3)
        nan where a marker was not seen.
    """

    times_s: FloatArray
    places_mm: Mapping[str, FloatArray]

    def mean(self, name: str, window_s: tuple[float, float]) -> FloatArray:
        """Mean place of a marker in a window of time, shape (3,).

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
        seen = self.places_mm[name][inside]
        seen = seen[np.isfinite(seen).all(axis=1)]
        if not len(seen):
            raise InputError(
                f"The marker {name} was not seen between {low:g} and {high:g} s; the recording "
                f"lasts from {self.times_s[0]:g} to {self.times_s[-1]:g} s."
            )
        return np.asarray(seen.mean(axis=0))


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
    """Columns of numbers of a comma-separated file; an empty cell is nan.

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


def rotation_to(body_mm: FloatArray, seen_mm: FloatArray) -> FloatArray:
    """Rotation R that turns directions of the cameras into those of the body, shape (3, 3).

    Parameters
    ----------
    body_mm, seen_mm : ndarray, shape (k, 3)
        The same markers at rest, in the frame of the body and of the cameras.

    Raises
    ------
    InputError
        If fewer than three are given, or all lie on a line.
    """
    a, b = body_mm - body_mm.mean(axis=0), seen_mm - seen_mm.mean(axis=0)
    spread = np.linalg.svd(a, compute_uv=False)
    if len(a) < 3 or spread[1] < 1e-3 * spread[0]:
        raise InputError(
            f"A frame needs at least three markers that are not on a line, found {len(a)}."
        )
    U, _, Vt = np.linalg.svd(a.T @ b)
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    return np.asarray(U @ turn @ Vt)


def misfit_mm(body_mm: FloatArray, seen_mm: FloatArray) -> FloatArray:
    """Distance of each marker from its place after the best rigid motion, shape (k,)."""
    R = rotation_to(body_mm, seen_mm)
    left = (seen_mm - seen_mm.mean(axis=0)) @ R.T - (body_mm - body_mm.mean(axis=0))
    return np.asarray(np.linalg.norm(left, axis=1))


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviations of one recording: of each marker, and common to all of them."""

    own_mm: float
    common_mm: float


def scatter_of(repeats: FloatArray) -> Scatter:
    """Standard deviations from displacements of several repeats, shape (r, k, 3), r >= 2.

    Raises
    ------
    InputError
        If there is one recording only.
    """
    r, k, _ = repeats.shape
    if r < 2:
        raise InputError("Scatter needs at least two repeats of a state, found one.")
    away = repeats - repeats.mean(axis=0)
    shared = away.mean(axis=1, keepdims=True)
    common = float((shared**2).sum() / (3 * (r - 1)))
    if k < 2:
        return Scatter(float(np.sqrt(common)), 0.0)
    own = float(((away - shared) ** 2).sum() / (3 * (r - 1) * (k - 1)))
    return Scatter(float(np.sqrt(own)), float(np.sqrt(max(0.0, common - own / k))))


def component_covariance(
    scatters: Sequence[Scatter], points: int, repeats: Sequence[int], floor: Scatter
) -> FloatArray:
    """Covariance of the components of all states, shape (3 s k, 3 s k).

    Row ``3 (s k + i) + c`` is component c of point i in state s. What a recording has for
    itself falls with the number of repeats. Errors that all repeats share, a base that was
    set down askew or a body that was not at rest, do not: they are believed to be as large
    as those that repeats show, and no smaller than `floor`.

    Parameters
    ----------
    scatters : sequence of Scatter
        Of one recording of each state.
    points : int
    repeats : sequence of int
        Of each state.
    floor : Scatter
    """
    size = 3 * points
    whole = np.zeros((len(scatters) * size, len(scatters) * size))
    same_axis = np.kron(np.ones((points, points)), np.eye(3))
    for s, (scatter, r) in enumerate(zip(scatters, repeats, strict=True)):
        own = max(scatter.own_mm**2 / r, floor.own_mm**2)
        common = max(scatter.common_mm**2, floor.common_mm**2)
        rows = slice(s * size, (s + 1) * size)
        whole[rows, rows] = own * np.eye(size) + common * same_axis
    return whole
