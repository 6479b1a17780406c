"""What was observed of a specimen: points of its body, their displacements, and their noise."""

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from storage.errors import InputError
from storage.values import BoolArray, FloatArray, Triple
from workers.comparison.observation.marker_noise import Scatter, component_covariance, scatter_of
from workers.comparison.observation.marker_recording import Recording, read_recording, read_table
from workers.comparison.observation.rigid_registration import misfit_mm, rotation_to
from workers.mechanics.fem.loads import DisplacementField
from workers.organs.specimen.problem import region_of
from workers.organs.specimen.spec import FieldSpec, MarkersSpec, SpecimenSpec

# Markers at rest this far off their places have been mixed up, or misread.
FARTHEST_MM = 10.0
# Points of a field that show how a region moves, at least: an affine motion of a plane.
FEWEST = 4
POINT = ("x_mm", "y_mm", "z_mm")
MOVE = ("ux_mm", "uy_mm", "uz_mm")


@dataclass(frozen=True, eq=False)
class Observed:
    """Displacements of k points in s states.

    Parameters
    ----------
    points_mm : ndarray, shape (k, 3)
        Where the model believes them, in the frame of the body.
    names : tuple of str
    moved_mm : ndarray, shape (s, k, 3)
        Means over the repeats.
    covariance : ndarray, shape (3 s k, 3 s k)
        See `workers.comparison.observation.marker_noise.component_covariance`.
    sd_mm : float
        Of a component of one point, typically.
    misfit_mm : float
        Of the markers at rest from the places they should have; 0 without a frame.
    repeats_mm : tuple of float
        Mean absolute difference between the first two repeats of each state; nan for one.
    boundary_mm : ndarray, shape (b, 3)
        Points of a field whose displacement is prescribed; none of the k points.
    boundary_moved_mm : ndarray, shape (s, b, 3)
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

    def boundary_of(self, state: int, spec: SpecimenSpec) -> dict[str, DisplacementField]:
        """Return how each region moves that moves as was measured, in one of the states."""
        found = {}
        for name in spec.measured_regions:
            inside = region_of(spec.regions[name]).contains(self.boundary_mm)
            points, moved = self.boundary_mm[inside], self.boundary_moved_mm[state, inside]
            found[name] = DisplacementField(_triples(points), _triples(moved))
        return found


class _Noisy(Protocol):
    @property
    def sd_mm(self) -> float: ...
    @property
    def common_sd_mm(self) -> float | None: ...


def observed(spec: SpecimenSpec, folder: Path) -> Observed:
    """Read what the states of an experiment show.

    Parameters
    ----------
    spec : SpecimenSpec
    folder : Path
        To which the names of its files are relative.

    Raises
    ------
    InputError
        If a file is missing or lacks a column, or states show different points.
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
    )
    repeats, misfits = [], [0.0]
    for state in spec.states:
        recordings = [read(folder / file) for file in state.files]
        repeats.append(np.stack([_displacements(r, markers) for r in recordings]))
        misfits += [_misfit(r, markers) for r in recordings]
    points = np.array([m.at_mm for m in markers.markers.values()], np.float64)
    return _observed(points, names, repeats, markers, max(misfits))


def _of_field(spec: SpecimenSpec, field: FieldSpec, folder: Path) -> Observed:
    repeats = []
    points: FloatArray | None = None
    for state in spec.states:
        tables = [read_table(folder / file, [*POINT, *MOVE]) for file in state.files]
        for table, file in zip(tables, state.files, strict=True):
            found = np.column_stack([table[c] for c in POINT])
            points = found if points is None else points
            if found.shape != points.shape or np.abs(found - points).max() > 1e-6:
                raise InputError(f"{folder / file} lists other points than the files before it.")
        repeats.append(np.stack([np.column_stack([t[c] for c in MOVE]) for t in tables]))
    if points is None or not np.isfinite([*points.ravel(), *np.concatenate(repeats).ravel()]).all():
        raise InputError("Landmarks need places and displacements that are finite numbers, in mm.")
    inside = _on_boundary(spec, points)
    own = [r[:, ~inside] for r in repeats]
    names = tuple(str(n) for n in np.flatnonzero(~inside))
    return replace(
        _observed(points[~inside], names, own, field, 0.0),
        boundary_mm=points[inside],
        boundary_moved_mm=np.stack([r[:, inside].mean(axis=0) for r in repeats]),
    )


def _on_boundary(spec: SpecimenSpec, points: FloatArray) -> BoolArray:
    """Return which points of a field prescribe how a region moves, shape (k,)."""
    inside = np.zeros(len(points), np.bool_)
    for name in spec.measured_regions:
        here = region_of(spec.regions[name]).contains(points)
        if here.sum() < FEWEST:
            raise InputError(
                f"The region {name} moves as was measured, but {int(here.sum())} points of the "
                f"field lie in it; at least {FEWEST} are needed. Give it as a box that holds "
                "a layer of points."
            )
        if len(np.unique(points[here], axis=0)) < here.sum():
            raise InputError(
                f"The region {name} moves as was measured, but points of the field in it are "
                "listed twice. List each point once, with one displacement."
            )
        inside |= here
    if inside.all():
        raise InputError("All points of the field prescribe what moves; none is left to compare.")
    return inside


def _triples(rows: FloatArray) -> tuple[Triple, ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)


def _displacements(recording: Recording, markers: MarkersSpec) -> FloatArray:
    """Return those of each marker in the frame of the body, shape (k, 3)."""
    moved = np.array(
        [
            recording.mean(name, markers.loaded_s) - recording.mean(name, markers.rest_s)
            for name in markers.markers
        ]
    )
    return moved if markers.frame is None else moved @ rotation_to(*_at_rest(recording, markers)).T


def _misfit(recording: Recording, markers: MarkersSpec) -> float:
    if markers.frame is None:
        return 0.0
    off = misfit_mm(*_at_rest(recording, markers))
    worst = int(off.argmax())
    if off[worst] > FARTHEST_MM:
        raise InputError(
            f"The marker {list(markers.frame.at_rest_mm)[worst]} lies {off[worst]:.1f} mm off its "
            "place at rest after the best rigid motion. Check markers.frame.at_rest_mm and "
            "markers.mm_per_unit: places may be mixed up, or in another unit."
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
    several = [r for r in repeats if len(r) > 1]
    if len({r.shape[1] for r in repeats}) > 1:
        raise InputError("All states must show the same points.")
    typical = _pooled([scatter_of(r) for r in several]) if several else Scatter(0.0, 0.0)
    scatters = [scatter_of(r) if len(r) > 1 else typical for r in repeats]
    floor = Scatter(stated.sd_mm, stated.common_sd_mm or 0.0)
    counts = [len(r) for r in repeats]
    whole = component_covariance(scatters, len(points), counts, floor)
    differ = [float(np.abs(r[0] - r[1]).mean()) if len(r) > 1 else float("nan") for r in repeats]
    return Observed(
        points,
        names,
        np.stack([r.mean(axis=0) for r in repeats]),
        whole,
        float(np.sqrt(np.diag(whole).mean())),
        misfit,
        tuple(differ),
    )


def _pooled(scatters: list[Scatter]) -> Scatter:
    own = np.sqrt(np.mean([s.own_mm**2 for s in scatters]))
    common = np.sqrt(np.mean([s.common_mm**2 for s in scatters]))
    return Scatter(float(own), float(common))
