r"""Tracked markers: recordings, frames in which one was lost, registration and noise.

Positions of markers over time are read from a table; positions at rest and under load are means
over time windows.

Lost markers are detected however they are recorded. A tracker that loses a marker leaves the
cell empty, writes the same number for all three coordinates (0, -1, 9999), misplaces the marker
for some frames, or repeats its last position while all others move.

The rotation from the camera frame to the body frame comes from the rigid motion that best fits
the markers at rest (W. Kabsch, Acta Cryst. A 32 (1976) 922; B. K. P. Horn, J. Opt. Soc. Am. A 4
(1987) 629).

The noise in the displacements is estimated from repeats: component c of the displacement of
marker i in repeat r scatters as

.. math:: d_{rci} = \mu_{ci} + a_{rc} + e_{rci}, \qquad a \sim N(0, \sigma_a^2),
          \quad e \sim N(0, \sigma_e^2):

an error common to all markers of a recording, and an error of each marker. An analysis of
variance of the repeats estimates both, but not an error that all repeats share.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.comparison.observation.number_table import read_table

# A marker that moves this many times more than any other has jumped.
ALONE = 5.0
# So has a marker that moves this many times more than usual.
UNUSUAL = 20.0
# Minimum number of frames that repeat a position, while other markers move, to be stale.
STALE_FRAMES = 3
# Steps smaller than this fraction of the largest count as rest.
REST = 0.1
# Markers at rest more often than this while others move are never considered stale.
OFTEN_STILL = 0.1


def without_lost(places_mm: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the positions of markers, shape (t, 3) each, with nan where a marker was lost."""
    names = list(places_mm)
    seen = np.stack([np.asarray(places_mm[name], np.float64) for name in names])
    seen[~np.isfinite(seen)] = np.nan
    lost = np.isnan(seen).any(axis=2) | (seen == 0).all(axis=2)
    lost |= _placeholders(seen, lost)
    lost |= _excursions(seen, lost)
    lost |= _stale(seen, lost)
    seen = np.where(lost[..., None], np.nan, seen)
    return dict(zip(names, seen, strict=True))


def _placeholders(seen: FloatArray, lost: BoolArray) -> BoolArray:
    """Return a mask of frames with a placeholder number in all coordinates, shape (k, t)."""
    same = ~lost & (seen[..., 0] == seen[..., 1]) & (seen[..., 1] == seen[..., 2])
    found = np.zeros_like(lost)
    for number in np.unique(seen[..., 0][same]):
        here = same & (seen[..., 0] == number)
        if here.any(axis=1).sum() > 1:
            found |= here
        else:
            found |= here & _jumped(seen, lost | here, here)
    return found


def _jumped(seen: FloatArray, lost: BoolArray, asked: BoolArray) -> BoolArray:
    """Return a mask of the `asked` frames in which the marker is far from its other positions."""
    jumped = np.zeros_like(lost)
    for marker, frame in np.argwhere(asked):
        known = np.flatnonzero(~lost[marker])
        if not len(known):
            continue
        nearest = known[np.abs(known - frame).argmin()]
        jump = np.linalg.norm(seen[marker, frame] - seen[marker, nearest])
        others = np.linalg.norm(seen[:, frame] - seen[:, nearest], axis=1)[~lost[:, frame]]
        steps = np.linalg.norm(np.diff(seen[marker, known], axis=0), axis=1)
        usual = _usual(steps) * abs(frame - nearest)
        jumped[marker, frame] = jump > ALONE * max(usual, others.max(initial=0.0))
    return jumped


def _usual(steps: FloatArray) -> float:
    """Return a typical nonzero step; 0 if there are too few.

    It is the lower quartile, because many of the few steps may be jumps.
    """
    moved = steps[steps > 0]
    return float(np.quantile(moved, 0.25)) if len(moved) > 4 else 0.0


def _excursions(seen: FloatArray, lost: BoolArray) -> BoolArray:
    """Return a mask of frames in which a single marker has jumped away, before it jumps back."""
    excursions = np.zeros_like(lost)
    if len(seen) < 2:
        return excursions
    for marker, places in enumerate(seen):
        known = np.flatnonzero(~lost[marker]).astype(np.int32)
        steps = np.linalg.norm(np.diff(places[known], axis=0), axis=1)
        others = _largest_other_step(seen, lost, marker, known)
        limit = np.maximum(ALONE * others, UNUSUAL * _usual(steps))
        jumps = np.flatnonzero(steps > limit)
        returned = -1
        for out, back in itertools.pairwise(jumps.tolist()):
            apart = np.linalg.norm(places[known[back + 1]] - places[known[out]])
            if out != returned and apart * ALONE < min(steps[out], steps[back]):
                excursions[marker, known[out + 1 : back + 1]] = True
                returned = back
    return excursions


def _largest_other_step(
    seen: FloatArray, lost: BoolArray, marker: int, known: IntArray
) -> FloatArray:
    """Return the longest step of any other marker between known frames, shape (len(known) - 1,)."""
    steps = np.linalg.norm(np.diff(seen[:, known], axis=1), axis=2)
    bad = lost[:, known]
    steps = np.where(bad[:, 1:] | bad[:, :-1], 0.0, steps)
    return np.asarray(np.delete(steps, marker, axis=0).max(axis=0, initial=0.0))


def _stale(seen: FloatArray, lost: BoolArray) -> BoolArray:
    """Return a mask of frames that repeat a marker's last position while others move."""
    stale = np.zeros_like(lost)
    if len(seen) < 2 or seen.shape[1] < STALE_FRAMES + 2:
        return stale
    places = np.where(lost[..., None], np.nan, seen)
    changes = np.abs(np.diff(places, axis=1))
    steps = np.linalg.norm(changes, axis=2)
    resolution = float(changes[changes > 0].min(initial=np.inf))
    for marker, own in enumerate(steps):
        rest = np.nan_to_num(np.delete(steps, marker, axis=0))
        others = np.median(rest, axis=0)
        moving = others > REST * others.max(initial=0.0)
        for first, last in _runs(own == 0):
            outside = moving.copy()
            outside[first : last + 1] = False
            usual = own[outside & np.isfinite(own)]
            if moving[first : last + 1].sum() < STALE_FRAMES or not len(usual):
                continue
            net = np.linalg.norm(places[:, last + 1] - places[:, first], axis=1)
            if np.median(np.nan_to_num(np.delete(net, marker))) < ALONE * resolution:
                continue  # no motion beyond rounding
            goes_along = np.median(usual) > REST * np.median(others[outside])
            if goes_along and (usual == 0).mean() < OFTEN_STILL:
                stale[marker, first + 1 : last + 2] = True
    return stale


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return the first and last index of each run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


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
        row = int(late[0])
        raise InputError(
            f"{path}, line {lines[row + 1]}: the time {times_s[row + 1]:g} s follows "
            f"{times_s[row]:g} s on line {lines[row]}. Times must increase: sort the rows, and use "
            "a separate file for each recording."
        )


def rotation_to(body_mm: FloatArray, seen_mm: FloatArray) -> FloatArray:
    """Return the rotation R from the camera frame to the body frame, shape (3, 3).

    Parameters
    ----------
    body_mm, seen_mm : ndarray, shape (k, 3)
        Positions of the same markers at rest, in the body frame and in the camera frame.

    Raises
    ------
    InputError
        If there are fewer than three markers, or all are on one line.
    """
    a, b = body_mm - body_mm.mean(axis=0), seen_mm - seen_mm.mean(axis=0)
    spread = np.linalg.svd(a, compute_uv=False)
    if len(a) < 3 or spread[1] < 1e-3 * spread[0]:
        raise InputError(
            f"Registration needs at least three markers that are not on one line, found {len(a)}."
        )
    U, _, Vt = np.linalg.svd(a.T @ b)
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    return np.asarray(U @ turn @ Vt)


def misfit_mm(body_mm: FloatArray, seen_mm: FloatArray) -> FloatArray:
    """Return the residual of each marker after the best rigid motion, shape (k,)."""
    R = rotation_to(body_mm, seen_mm)
    left = (seen_mm - seen_mm.mean(axis=0)) @ R.T - (body_mm - body_mm.mean(axis=0))
    return np.asarray(np.linalg.norm(left, axis=1))


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviations of one recording: of each marker's own error, and of the common error."""

    own_mm: float
    common_mm: float


def scatter_of(repeats: FloatArray) -> Scatter:
    """Estimate the standard deviations from repeats, shape (r, k, axes), r >= 2.

    Raises
    ------
    InputError
        If there is only one recording.
    """
    r, k, axes = repeats.shape
    if r < 2:
        raise InputError("Estimating the scatter needs at least two repeats of a state, found one.")
    away = repeats - repeats.mean(axis=0)
    shared = away.mean(axis=1, keepdims=True)
    common = float((shared**2).sum() / (axes * (r - 1)))
    if k < 2:
        return Scatter(float(np.sqrt(common)), 0.0)
    own = float(((away - shared) ** 2).sum() / (axes * (r - 1) * (k - 1)))
    return Scatter(float(np.sqrt(own)), float(np.sqrt(max(0.0, common - own / k))))


def component_covariance(
    scatters: Sequence[Scatter], points: int, repeats: Sequence[int], floor: Scatter
) -> FloatArray:
    """Return the covariance of the components of all states, shape (3 s k, 3 s k).

    Row ``3 (s k + i) + c`` is component c of point i in state s. Errors of single recordings
    average out over the repeats. Errors that all repeats share, such as a tilted base or a body
    that was not at rest, do not: they are assumed to be as large as the errors between repeats, and
    at least `floor`.

    Parameters
    ----------
    scatters : sequence of Scatter
        Scatter of one recording of each state.
    points : int
    repeats : sequence of int
        Number of repeats of each state.
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
