"""Observations of a specimen: points of its body, their displacements and noise.

Points are markers, or a table of displacements of many points, some components of which may be
missing. Image correlation with one camera cannot measure motion along its axis, and any correlation
loses some points: an absent column, an empty cell or nan means that a component was not measured.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, Triple
from palpate.workers.comparison.observation.marker_tracking import (
    Recording,
    Scatter,
    component_covariance,
    misfit_mm,
    read_recording,
    rotation_to,
    scatter_of,
)
from palpate.workers.comparison.observation.number_table import NumberTable, read_table
from palpate.workers.mechanics.fem.loads_and_regions import DisplacementField
from palpate.workers.organs.specimen.specimen_keys import (
    LoadsSpec,
    MoveSpec,
    PredictSpec,
    SpecimenSpec,
)
from palpate.workers.organs.specimen.specimen_problem import held_axes, region_of
from palpate.workers.organs.specimen.specimen_recording_keys import FieldSpec, MarkersSpec

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
    held_out_mm : tuple of ndarray, shape (r, k, 3)
        The same for each state under ``predict``; r is 0 without recordings.
    notes : tuple of str
        Notes on components that are not compared.
    """

    points_mm: FloatArray
    repeats_mm: tuple[FloatArray, ...]
    held_out_mm: tuple[FloatArray, ...]
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
    for state in spec.recorded:
        moved = []
        for file in state.files:
            path = folder / file
            wanted, optional = (POINT[:2], (POINT[2], *MOVE)) if is_sheet else (POINT, MOVE)
            table = read_table(path, wanted, optional, UNITS)
            positions = _columns(table, POINT)
            if is_sheet and POINT[2] not in table.columns:
                positions[:, 2] = 0.0
            points = positions if points is None else points
            _check_points(path, table, positions, points)
            moved.append(_field_displacements(path, table))
        repeats.append(moved)
    if points is None:
        raise AssertionError("an experiment has states")
    every = [np.reshape(moved, (-1, *points.shape)) for moved in repeats]
    fitted = len(spec.states)
    tables = FieldTables(points, tuple(every[:fitted]), tuple(every[fitted:]), ())
    return replace(tables, notes=_notes(tables.measured))


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


def _field_displacements(path: Path, table: NumberTable) -> FloatArray:
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


# Markers at rest this far from their stated positions were mixed up or misread.
FARTHEST_MM = 10.0
# Fewest points of a field that determine the motion of a region: an affine motion of a plane.
FEWEST = 4
# Repeats that scatter by more than this multiple of the stated noise need a confirmation; the
# second limit applies to single points.
MOST_SCATTER, MOST_OF_ONE = 5.0, 20.0


@dataclass(frozen=True, eq=False)
class Observed:
    """Displacements of k points in s states.

    Parameters
    ----------
    points_mm : ndarray, shape (k, 3)
        Positions in the model, in the frame of the body.
    names : tuple of str
    moved_mm : ndarray, shape (s, k, 3)
        Means over the repeats; nan for components that were not measured.
    covariance : ndarray, shape (s m, s m)
        Covariance of the m compared components of each state; see
        `workers.comparison.observation.marker_tracking.component_covariance`.
    sd_mm : float
        Typical standard deviation of a component of one point.
    misfit_mm : float
        Distance of the markers at rest from their stated positions; 0 without a frame.
    repeats_mm : tuple of float
        Mean absolute difference between the first two repeats of each state; nan without repeats.
    boundary_mm : ndarray, shape (b, 3)
        Points of a field whose displacement is prescribed, not among the k points.
    boundary_moved_mm : ndarray, shape (s, b, 3)
        Displacements of these points.
    held_out_points_mm : ndarray, shape (h, 3)
        Points in the recordings of held-out states: first the k points, then all others.
    held_out_mm : ndarray, shape (p, h, 3)
        Displacements of these points in the p states under ``predict``; nan where not measured.
    recording_sd_mm : float
        Typical standard deviation of a component of one point in one recording: the scatter
        between repeats, at least as stated.
    notes : tuple of str
        Notes on missing data in the recordings.
    scatter : str
        Warning if repeats differ by far more than the stated noise; empty otherwise.
    """

    points_mm: FloatArray
    names: tuple[str, ...]
    moved_mm: FloatArray
    covariance: FloatArray
    sd_mm: float
    misfit_mm: float
    repeats_mm: tuple[float, ...]
    boundary_mm: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    boundary_moved_mm: FloatArray = field(default_factory=lambda: np.empty((0, 0, 3)))
    held_out_points_mm: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    held_out_mm: FloatArray = field(default_factory=lambda: np.empty((0, 0, 3)))
    recording_sd_mm: float = 0.0
    notes: tuple[str, ...] = ()
    scatter: str = ""

    @property
    def measured(self) -> BoolArray:
        """Mask of the compared components, shape (k, 3)."""
        return np.all(np.isfinite(self.moved_mm), axis=0)

    def boundary_of(self, state: LoadsSpec, spec: SpecimenSpec) -> dict[str, DisplacementField]:
        """Return the displacement fields of regions that move as measured, in one state."""
        points, moved = self.boundary_mm, self.boundary_moved_mm
        if state in spec.predict:
            points, moved = self.held_out_points_mm, self.held_out_mm
        number = (spec.predict if state in spec.predict else spec.states).index(state)
        found = {}
        for name in _names(state.measured_moves):
            axes = _measured_axes(state.measured_moves, name)
            known = np.isfinite(moved[number][:, axes]).all(axis=1)
            inside = region_of(spec.regions[name]).contains(points) & known
            here = np.nan_to_num(moved[number, inside])
            found[name] = DisplacementField(_triples(points[inside]), _triples(here))
        return found

    def held_out_of(self, state: PredictSpec, spec: SpecimenSpec) -> FloatArray:
        """Return the displacements with which a prediction is compared, nan elsewhere, (k, 3)."""
        k = len(self.points_mm)
        moved = np.array(self.held_out_mm[spec.predict.index(state), :k])
        moved[~self.measured] = np.nan
        for name in _names(state.measured_moves):
            moved[region_of(spec.regions[name]).contains(self.points_mm)] = np.nan
        return moved


class _Noisy(Protocol):
    @property
    def sd_mm(self) -> float: ...
    @property
    def common_sd_mm(self) -> float | None: ...


def observed(spec: SpecimenSpec, folder: Path) -> Observed:
    """Read the recordings of an experiment.

    Parameters
    ----------
    spec : SpecimenSpec
    folder : Path
        Folder to which the names of its files are relative.

    Raises
    ------
    InputError
        If a file is missing or lacks a column, or the points of the states differ.
    """
    if spec.markers is not None:
        return _of_markers(spec, spec.markers, folder)
    if spec.field is None:
        raise AssertionError("an experiment has markers or a field")
    return _of_field(spec, spec.field, folder)


def _of_markers(spec: SpecimenSpec, markers: MarkersSpec, folder: Path) -> Observed:
    names = tuple(markers.markers)
    wanted = list(dict.fromkeys([*names, *(markers.frame.at_rest_mm if markers.frame else ())]))
    read = partial(
        read_recording,
        time=markers.time,
        column=markers.column,
        names=wanted,
        mm_per_unit=markers.mm_per_unit,
        z_is_optional=spec.body.sheet is not None,
    )
    points = np.array([m.at_mm for m in markers.markers.values()], np.float64)
    every, misfits, notes = [], [0.0], []
    for state in spec.recorded:
        recordings = [read(folder / file) for file in state.files]
        moved = [_marker_displacements(r, markers) for r in recordings]
        every.append(np.reshape(moved, (-1, *points.shape)))
        misfits += [_misfit(r, markers) for r in recordings]
        notes += [note for r in recordings for note in r.notes]
    repeats, held_out = every[: len(spec.states)], every[len(spec.states) :]
    observation = replace(
        _observed(points, names, repeats, markers, max(misfits)),
        notes=tuple(notes),
        held_out_points_mm=points,
        held_out_mm=_means(held_out, points),
    )
    return _with_scatter(observation, spec, repeats)


def _of_field(spec: SpecimenSpec, field: FieldSpec, folder: Path) -> Observed:
    tables = read_field(spec, folder)
    points, measured = tables.points_mm, tables.measured
    inside = _on_boundary(spec, spec.measured_moves, points, measured)
    for state, moved in zip(spec.predict, tables.held_out_mm, strict=True):
        known = np.asarray(np.isfinite(moved).all(axis=0))
        _on_boundary(spec, state.measured_moves, points, known, f" in the state {state.name}")
    compared = ~inside & measured.any(axis=1)
    if not compared.any():
        raise InputError("All points of the field prescribe motion; none is left to compare.")
    own = [np.where(measured, r, np.nan)[:, compared] for r in tables.repeats_mm]
    names = tuple(str(n) for n in np.flatnonzero(compared))
    # A component that was not measured at a point of the boundary is not prescribed either.
    boundary = [np.nan_to_num(r[:, inside].mean(axis=0)) for r in tables.repeats_mm]
    order = np.argsort(~compared, kind="stable")
    observation = replace(
        _observed(points[compared], names, own, field, 0.0),
        boundary_mm=points[inside],
        boundary_moved_mm=np.stack(boundary),
        held_out_points_mm=points[order],
        held_out_mm=_means(tables.held_out_mm, points)[:, order],
        notes=tables.notes,
    )
    return _with_scatter(observation, spec, own)


def _means(repeats: Sequence[FloatArray], points: FloatArray) -> FloatArray:
    """Return the means over repeats, nan without any, shape (s, k, 3)."""
    means = [r.mean(axis=0) if len(r) else np.full(points.shape, np.nan) for r in repeats]
    return np.reshape(means, (-1, *points.shape))


def _on_boundary(
    spec: SpecimenSpec,
    moves: Sequence[MoveSpec],
    points: FloatArray,
    measured: BoolArray,
    where: str = "",
) -> BoolArray:
    """Return a mask of the points of a field that prescribe the motion of a region, shape (k,)."""
    inside = np.zeros(len(points), np.bool_)
    for name in _names(moves):
        axes = _measured_axes(moves, name)
        known = measured[:, axes]
        absent = np.flatnonzero(~known.any(axis=0))
        if len(absent):
            raise InputError(
                f"The region {name} moves as measured{where}, but {MOVE[axes[absent[0]]]} was not "
                "measured. Add the column, or list the axes that were measured: axes: [...]."
            )
        there = region_of(spec.regions[name]).contains(points)
        here = there & known.all(axis=1)
        if here.sum() < FEWEST:
            raise InputError(
                f"The region {name} moves as measured{where}, but {int(here.sum())} points of the "
                f"field with a displacement are in it; at least {FEWEST} are needed. Define it as "
                "a box that contains a layer of points."
            )
        if len(np.unique(points[here], axis=0)) < here.sum():
            raise InputError(
                f"The region {name} moves as measured{where}, but points of the field in it are "
                "listed twice. List each point once, with one displacement."
            )
        inside |= here
    return inside


def _names(moves: Sequence[MoveSpec]) -> list[str]:
    """Return the names of the moved regions, each once."""
    return list(dict.fromkeys(move.region for move in moves))


def _measured_axes(moves: Sequence[MoveSpec], region: str) -> list[int]:
    """Return the axes along which a region moves as measured."""
    own = [move for move in moves if move.region == region]
    return [a for a in range(3) if any(held_axes(m.axes)[a] for m in own)]


def _triples(rows: FloatArray) -> tuple[Triple, ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)


def _marker_displacements(recording: Recording, markers: MarkersSpec) -> FloatArray:
    """Return the displacement of each marker in the frame of the body, shape (k, 3)."""
    moved = np.array(
        [
            recording.mean(name, markers.loaded_s) - recording.mean(name, markers.rest_s)
            for name in markers.markers
        ]
    )
    if markers.frame is not None:
        moved = moved @ rotation_to(*_at_rest(recording, markers)).T
    if recording.is_flat:
        moved[:, 2] = np.nan
    return moved


def _misfit(recording: Recording, markers: MarkersSpec) -> float:
    if markers.frame is None:
        return 0.0
    off = misfit_mm(*_at_rest(recording, markers))
    worst = int(off.argmax())
    if off[worst] > FARTHEST_MM:
        raise InputError(
            f"The marker {list(markers.frame.at_rest_mm)[worst]} is {off[worst]:.1f} mm off its "
            "position at rest after the best rigid motion. Check markers.frame.at_rest_mm and "
            "markers.mm_per_unit: markers may be mixed up, or in another unit."
        )
    return float(np.sqrt((off**2).mean()))


def _at_rest(recording: Recording, markers: MarkersSpec) -> tuple[FloatArray, FloatArray]:
    if markers.frame is None:
        raise AssertionError("only a frame is fitted")
    wanted = markers.frame.at_rest_mm
    at_rest = np.array([recording.mean(name, markers.rest_s) for name in wanted])
    return np.array(list(wanted.values()), np.float64), at_rest


def _observed(
    points: FloatArray,
    names: tuple[str, ...],
    repeats: list[FloatArray],
    stated: _Noisy,
    misfit: float,
) -> Observed:
    if len({r.shape[1] for r in repeats}) > 1:
        raise InputError("All states must have the same points.")
    measured = np.isfinite(repeats[0][0])
    several = [_complete(r) for r in repeats if len(r) > 1]
    typical = _pooled([scatter_of(r) for r in several]) if several else Scatter(0.0, 0.0)
    scatters = [scatter_of(_complete(r)) if len(r) > 1 else typical for r in repeats]
    floor = Scatter(stated.sd_mm, stated.common_sd_mm or 0.0)
    counts = [len(r) for r in repeats]
    whole = component_covariance(scatters, len(points), counts, floor)
    if not measured.all():
        compared = np.tile(measured.ravel(), len(repeats))
        whole = whole[np.ix_(compared, compared)]
    recorded = float(np.hypot(typical.own_mm, typical.common_mm))
    differ = [
        float(np.nanmean(np.abs(r[0] - r[1]))) if len(r) > 1 else float("nan") for r in repeats
    ]
    return Observed(
        points,
        names,
        np.stack([r.mean(axis=0) for r in repeats]),
        whole,
        float(np.sqrt(np.diag(whole).mean())),
        misfit,
        tuple(differ),
        recording_sd_mm=max(recorded, float(np.hypot(floor.own_mm, floor.common_mm))),
    )


def _complete(repeats: FloatArray) -> FloatArray:
    """Return the repeats at completely measured points and axes, shape (r, k, axes)."""
    axes = np.isfinite(repeats).all(axis=0).any(axis=0)
    found = repeats[..., axes]
    points = np.isfinite(found).all(axis=(0, 2))
    if not points.any():
        raise InputError(
            "No point of the field is complete in all repeats of a state, so their noise cannot "
            "be estimated. Leave out the repeat with the most gaps."
        )
    return np.asarray(found[:, points])


def _with_scatter(found: Observed, spec: SpecimenSpec, repeats: list[FloatArray]) -> Observed:
    """Add a warning if repeats differ by far more than the stated noise."""
    expected = spec.stated_sd_mm
    for state, moved in zip(spec.states, repeats, strict=True):
        if len(moved) < 2:
            continue
        scatter = scatter_of(_complete(moved))
        size = float(np.hypot(scatter.own_mm, scatter.common_mm))
        away = np.sqrt(np.nanmean(moved.var(axis=0, ddof=1), axis=1))
        worst = int(np.nanargmax(away))
        if size <= MOST_SCATTER * expected and away[worst] <= MOST_OF_ONE * expected:
            continue
        text = (
            f"The repeats of the state {state.name} scatter by {size:.2g} mm, "
            f"{size / expected:.2g} times the stated {expected:.2g} mm; {found.names[worst]} "
            f"scatters most, by {away[worst]:.2g} mm."
        )
        return replace(found, scatter=text)
    return found


def _pooled(scatters: list[Scatter]) -> Scatter:
    own = np.sqrt(np.mean([s.own_mm**2 for s in scatters]))
    common = np.sqrt(np.mean([s.common_mm**2 for s in scatters]))
    return Scatter(float(own), float(common))
