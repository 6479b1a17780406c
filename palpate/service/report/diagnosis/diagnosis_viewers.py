"""Data of the viewers on a diagnosis page: the gap on the body, and slices of every scan.

Displacement and gap of the tissue are interpolated from the points of the diagnosis, to vertices of
the surfaces in the 3-D viewer and to voxels of the slices.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from markupsafe import Markup
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree

from palpate.service.report.diagnosis.gap_maps import FARTHEST_MM, SIGNIFICANT, gap_range_mm
from palpate.service.report.diagnosis.gap_pictures import (
    SHAPE_PARTS,
    has_surface_gaps,
    titled_models,
)
from palpate.service.report.drawing import colours
from palpate.service.report.drawing.volume_sections import VIEWS, middle_mm, plates_touching
from palpate.service.report.page.page_elements import script, thinned
from palpate.service.report.page.page_viewers import (
    BodyScan,
    BodySurface,
    SlicePanel,
    SliceSet,
    body_viewer,
    slice_viewer,
)
from palpate.storage.stored_arrays import Arrays
from palpate.storage.values import BoolArray, FloatArray, Tissue, Triple, Volume
from palpate.workers.diagnosis.problem.planned_acquisition import INTERFACES
from palpate.workers.mechanics.fem.loads_and_regions import Pressed

FIELD_MEANINGS = {
    "displacement": "displacement of the tissue in the model",
    "gap": "gap between model and scan, beyond the noise",
}
VOXEL_NEIGHBOURS = 12  # number of points for interpolating a displacement
VOXEL_NEAREST = 4  # the same for a gap
MOST_FIELD_VOXELS = 60_000
GAP_BAND_MM = 2.0  # distance from an interface within which its gap is shown


def slice_fields(
    found: Arrays, scan: int, bodies: Mapping[str, Volume], models: Sequence[str]
) -> dict[str, Volume]:
    """Return fields on the predicted bodies, by ``NAME:MODEL``.

    Parameters
    ----------
    found : dict of str to ndarray
        Arrays of the outcome; see `workers.diagnosis.outcome.body_pictures`.
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
        coarse = thinned(bodies[model], MOST_FIELD_VOXELS)
        length = np.linalg.norm(moved - found["points"], axis=1)
        near = _within_reach(coarse.values != 0, coarse, 2 * max(coarse.spacing_mm))
        fields[f"displacement:{model}"] = _at_voxels(coarse, near, moved, length, VOXEL_NEIGHBOURS)
        if f"local_{model}" in found:
            fields[f"gap:{model}"] = _gap_field(found, scan, model, moved, coarse)
    return fields


def _gap_field(found: Arrays, scan: int, model: str, moved: FloatArray, lattice: Volume) -> Volume:
    """Return the size of the residual near each interface, set to zero within the noise."""
    local, sd = (found[f"local_{model}{end}"][scan] for end in ("", "_sd"))
    loud = np.where(np.abs(local) >= SIGNIFICANT * sd, np.abs(local), 0.0)
    values = np.full(lattice.values.shape, np.nan, np.float32)
    for own, near in _interface_bands(found, lattice):
        if own.any() and near.any():
            field = _at_voxels(lattice, near, moved[own], loud[own], VOXEL_NEAREST, FARTHEST_MM)
            values = np.where(near, field.values, values)
    return replace(lattice, values=values)


def _interface_bands(found: Arrays, lattice: Volume) -> Iterator[tuple[BoolArray, BoolArray]]:
    """Return the points and the voxels of each interface."""
    for number, interface in enumerate(INTERFACES):
        inside = np.isin(lattice.values, [int(tissue) for tissue in interface.inside])
        reach = max(GAP_BAND_MM, *lattice.spacing_mm)
        outside = _within_reach(inside, lattice, reach)
        yield (
            np.asarray(found["interface"]) == number,
            outside & _within_reach(~inside, lattice, reach),
        )


def _within_reach(inside: BoolArray, lattice: Volume, reach_mm: float) -> BoolArray:
    """Return the voxels inside a body or within a distance of it."""
    if not inside.any():
        return inside
    away = distance_transform_edt(~inside, sampling=lattice.spacing_mm[::-1])
    return np.asarray(away <= reach_mm)


def _at_voxels(
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
    away, which = (np.asarray(array).reshape(-1, count) for array in near_ones)
    weights = 1 / np.maximum(away, 0.1) ** 2
    there = (weights * values[which]).sum(axis=1) / weights.sum(axis=1)
    shown = np.full(near.shape, np.nan, np.float32)
    shown[near] = np.where(away[:, 0] > farthest_mm, np.nan, there)
    return replace(lattice, values=shown)


MODELS = ("before", "after")
OVERLAY_LEGEND = (
    ("outside both", "#ffffff00"),
    ("other tissue in both", "#8a94a12e"),
    ("glandular tissue in both", "#8a94a199"),
    ("in the scan, not predicted", "#107ac0ff"),
    ("predicted, not in the scan", "#d9651fff"),
)
# Number of neighbours for interpolating a displacement.
VERTEX_NEIGHBOURS = 12
# The same for a residual.
VERTEX_NEAREST = 4


def body_data(
    found: Arrays, scans: Sequence[str], named: str, loads: Mapping[str, Pressed]
) -> Markup | None:
    """Return the data of the 3-D viewer; None if the store has no surfaces.

    Parameters
    ----------
    found : dict of str to ndarray
        Arrays of the outcome; see `workers.diagnosis.outcome.body_pictures`.
    scans : sequence of str
        Names of the loaded scans.
    named : str
        Name of the effect; empty if there is none.
    loads : mapping of str to Pressed
        Known loads by the name of the scan.
    """
    if not has_surface_gaps(found):
        return None
    numbers = [n for n, i in enumerate(INTERFACES) if f"shape_{i.name}_vertices" in found]
    surfaces = [_body_surface(found, INTERFACES[number].name) for number in numbers]
    models = [
        (when, title)
        for when, title in titled_models(dict.fromkeys(MODELS, 0), named)
        if f"local_{when}" in found
    ]
    moved = _moved_vertices(found, len(scans), surfaces, models)
    told = [
        BodyScan(
            name,
            loads.get(name, Pressed()),
            moved[scan],
            [
                _gaps_at_vertices(found, scan, number, s.vertices, models)
                for number, s in zip(numbers, surfaces, strict=True)
            ],
        )
        for scan, name in enumerate(scans)
    ]
    shown = body_viewer(
        surfaces,
        told,
        models,
        "model outside (+) or inside (−) the scan, mean over about 8 mm; values within the "
        "noise are drawn as zero",
        gap_range_mm(found["local_before"], found["local_before_sd"]),
        first="gap",
    )
    return script("body", shown)


def slice_data(
    found: Arrays, scans: Sequence[str], named: str, loads: Mapping[str, Pressed]
) -> Markup | None:
    """Return the data of the slice viewer; None if the store has no bodies.

    Parameters
    ----------
    found, scans, named, loads
        As for `body_data`.
    """
    sets = []
    models: list[tuple[str, str]] = []
    for scan, name in enumerate(scans):
        if f"labels_{scan}" not in found:
            continue
        stack, frame = found[f"labels_{scan}"], found[f"labels_{scan}_frame"]
        (dx, dy, dz), (x, y, z) = np.asarray(frame).tolist()
        spacing: Triple = (dx, dy, dz)
        names = ("scan", *MODELS)[: len(stack)]
        volumes = {n: Volume(v, spacing, (x, y, z)) for n, v in zip(names, stack, strict=True)}
        models = list(titled_models(dict.fromkeys(names[1:], 0), named))
        pressed = loads.get(name)
        plates = (
            {n: plates_touching(v, pressed.axis) for n, v in volumes.items()} if pressed else {}
        )
        middle = middle_mm(volumes["scan"], (Tissue.GLANDULAR,))
        fields = slice_fields(found, scan, volumes, names[1:])
        sets.append(SliceSet(name, volumes, middle, plates, fields))
    if not sets:
        return None
    gland = (int(Tissue.GLANDULAR),)
    shown = slice_viewer(
        sets,
        [
            SlicePanel("Scan", "labels", ("scan",)),
            SlicePanel(
                "Model: $choice", "labels", ("$choice",), gland, "scan", tuple(FIELD_MEANINGS)
            ),
            SlicePanel("Difference: $choice", "overlay", ("scan", "$choice"), gland),
        ],
        VIEWS[:1] if next(iter(sets[0].volumes.values())).values.shape[0] == 1 else VIEWS,
        {int(t): (t.name.lower(), colour) for t, colour in colours.TISSUE_PALETTE.items() if t},
        OVERLAY_LEGEND,
        models,
        FIELD_MEANINGS,
    )
    return script("slices", shown)


def _body_surface(found: Arrays, name: str) -> BodySurface:
    vertices, triangles = (found[f"shape_{name}_{part}"] for part in SHAPE_PARTS)
    return BodySurface(
        name, colours.INTERFACE_PALETTE[name], np.asarray(vertices, np.float64), triangles
    )


def _moved_vertices(
    found: Arrays, scans: int, surfaces: Sequence[BodySurface], models: Sequence[tuple[str, str]]
) -> list[list[dict[str, FloatArray]]]:
    """Return the displaced vertices in each scan, by surface and model.

    They are interpolated from the known points in one call, because most of the time is spent on
    finding neighbours, which are the same for all scans and models.
    """
    points = np.asarray(found["points"], np.float64)
    known = [when for when, _ in models if f"moved_{when}" in found]
    if not known or len(points) < VERTEX_NEIGHBOURS:
        return [[{} for _ in surfaces] for _ in range(scans)]
    # (points, scans, models, 3)
    moves = np.stack([found[f"moved_{when}"] - points for when in known], axis=2)
    between = RBFInterpolator(
        points, moves.swapaxes(0, 1), neighbors=VERTEX_NEIGHBOURS, kernel="linear", degree=0
    )
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    moved = vertices[:, None, None] + between(vertices)
    ends = np.cumsum([len(surface.vertices) for surface in surfaces])
    parts = np.split(moved, ends[:-1])
    return [
        [{when: part[:, scan, k] for k, when in enumerate(known)} for part in parts]
        for scan in range(scans)
    ]


def _gaps_at_vertices(
    found: Arrays, scan: int, number: int, vertices: FloatArray, models: Sequence[tuple[str, str]]
) -> dict[str, FloatArray]:
    """Return residuals at vertices, zero if within the noise and nan where no point is near."""
    own = np.asarray(found["interface"]) == number
    if not own.any():
        return {}
    near = min(VERTEX_NEAREST, int(own.sum()))
    near_ones = KDTree(found["points"][own]).query(vertices, near)
    away, which = (np.asarray(array).reshape(-1, near) for array in near_ones)
    weights = 1 / np.maximum(away, 0.1) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    gaps = {}
    for when, _ in models:
        value = found[f"local_{when}"][scan, own]
        sd = found[f"local_{when}_sd"][scan, own]
        loud = np.where(np.abs(value) >= SIGNIFICANT * sd, value, 0.0)
        there = (weights * loud[which]).sum(axis=1)
        gaps[when] = np.asarray(np.where(away[:, 0] > FARTHEST_MM, np.nan, there))
    return gaps
