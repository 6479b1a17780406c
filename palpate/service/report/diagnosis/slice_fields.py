"""Displacement and gap of the tissue in the slices of a scan, from the points of a diagnosis."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree

from palpate.service.report.diagnosis.maps import SIGNIFICANT
from palpate.service.report.diagnosis.surfaces import FARTHEST_MM
from palpate.service.report.drawing.packed import thinned
from palpate.storage.stores.arrays import Arrays
from palpate.storage.values import BoolArray, FloatArray, Volume
from palpate.workers.diagnosis.problem.acquisition import INTERFACES

MEANINGS = {
    "displacement": "displacement of the tissue in the model",
    "gap": "gap between model and scan, beyond the noise",
}
NEIGHBOURS = 12  # number of points for interpolating a displacement
NEAREST = 4  # the same for a gap
MOST_VOXELS = 60_000
BAND_MM = 2.0  # distance from an interface within which its gap is shown


def slice_fields(
    found: Arrays, scan: int, bodies: Mapping[str, Volume], models: Sequence[str]
) -> dict[str, Volume]:
    """Return fields on the predicted bodies, by ``NAME:MODEL``.

    Parameters
    ----------
    found : dict of str to ndarray
        Arrays of the outcome; see `workers.diagnosis.outcome.pictures.drawings`.
    scan : int
    bodies : mapping of str to Volume
        `Tissue` labels by model.
    models : sequence of str
        ``before``, ``after``.
    """
    fields = {}
    for model in models:
        if f"moved_{model}" not in found or model not in bodies:
            continue
        moved = np.asarray(found[f"moved_{model}"][scan], np.float64)
        coarse = thinned(bodies[model], MOST_VOXELS)
        length = np.linalg.norm(moved - found["points"], axis=1)
        near = _near(coarse.values != 0, coarse, 2 * max(coarse.spacing_mm))
        fields[f"displacement:{model}"] = _between(coarse, near, moved, length, NEIGHBOURS)
        if f"local_{model}" in found:
            fields[f"gap:{model}"] = _gap(found, scan, model, moved, coarse)
    return fields


def _gap(found: Arrays, scan: int, model: str, moved: FloatArray, lattice: Volume) -> Volume:
    """Return the size of the residual near each interface, set to zero within the noise."""
    local, sd = (found[f"local_{model}{end}"][scan] for end in ("", "_sd"))
    loud = np.where(np.abs(local) >= SIGNIFICANT * sd, np.abs(local), 0.0)
    values = np.full(lattice.values.shape, np.nan, np.float32)
    for own, near in _bands(found, lattice):
        if own.any() and near.any():
            field = _between(lattice, near, moved[own], loud[own], NEAREST, FARTHEST_MM)
            values = np.where(near, field.values, values)
    return replace(lattice, values=values)


def _bands(found: Arrays, lattice: Volume) -> Iterator[tuple[BoolArray, BoolArray]]:
    """Return the points and the voxels of each interface."""
    for number, interface in enumerate(INTERFACES):
        inside = np.isin(lattice.values, [int(tissue) for tissue in interface.inside])
        reach = max(BAND_MM, *lattice.spacing_mm)
        outside = _near(inside, lattice, reach)
        yield np.asarray(found["interface"]) == number, outside & _near(~inside, lattice, reach)


def _near(inside: BoolArray, lattice: Volume, reach_mm: float) -> BoolArray:
    """Return the voxels inside a body or within a distance of it."""
    if not inside.any():
        return inside
    away = distance_transform_edt(~inside, sampling=lattice.spacing_mm[::-1])
    return np.asarray(away <= reach_mm)


def _between(
    lattice: Volume,
    near: BoolArray,
    points: FloatArray,
    values: FloatArray,
    neighbours: int,
    farthest_mm: float = np.inf,
) -> Volume:
    """Interpolate values at points (k, 3) by inverse squared distance; nan elsewhere."""
    voxels = np.argwhere(near)[:, ::-1] * lattice.spacing_mm + np.asarray(lattice.origin_mm)
    count = min(neighbours, len(points))
    near_ones = KDTree(points).query(voxels, count)
    away, which = (np.asarray(one).reshape(-1, count) for one in near_ones)
    weights = 1 / np.maximum(away, 0.1) ** 2
    there = (weights * values[which]).sum(axis=1) / weights.sum(axis=1)
    shown = np.full(near.shape, np.nan, np.float32)
    shown[near] = np.where(away[:, 0] > farthest_mm, np.nan, there)
    return replace(lattice, values=shown)
