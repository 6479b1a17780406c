"""Data of the viewers on a diagnosis page: the gap on the body, and slices of every scan."""

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup
from scipy.interpolate import RBFInterpolator
from scipy.spatial import KDTree

from palpate.service.report.diagnosis.maps import SIGNIFICANT, range_mm
from palpate.service.report.diagnosis.slice_fields import MEANINGS, slice_fields
from palpate.service.report.diagnosis.slices import titled
from palpate.service.report.diagnosis.surfaces import FARTHEST_MM
from palpate.service.report.diagnosis.where import PARTS, on_surfaces
from palpate.service.report.drawing import palette
from palpate.service.report.drawing.packed import script
from palpate.service.report.drawing.plates import plates_touching
from palpate.service.report.drawing.slices import VIEWS, middle_mm
from palpate.service.report.viewers.body import BodyScan, BodySurface, body_viewer
from palpate.service.report.viewers.slices import SlicePanel, SliceSet, slice_viewer
from palpate.storage.stores.arrays import Arrays
from palpate.storage.values import FloatArray, Tissue, Triple, Volume
from palpate.workers.diagnosis.problem.acquisition import INTERFACES
from palpate.workers.mechanics.pressed import Pressed

WHEN = ("before", "after")
OVERLAY = (
    ("outside both", "#ffffff00"),
    ("other tissue in both", "#8a94a12e"),
    ("glandular tissue in both", "#8a94a199"),
    ("in the scan, not predicted", "#107ac0ff"),
    ("predicted, not in the scan", "#d9651fff"),
)
# Number of neighbours for interpolating a displacement.
NEIGHBOURS = 12
# The same for a residual.
NEAREST = 4


def body_data(
    found: Arrays, scans: Sequence[str], named: str, loads: Mapping[str, Pressed]
) -> Markup | None:
    """Return the data of the 3-D viewer; None if the store has no surfaces.

    Parameters
    ----------
    found : dict of str to ndarray
        Arrays of the outcome; see `workers.diagnosis.outcome.pictures.drawings`.
    scans : sequence of str
        Names of the loaded scans.
    named : str
        Name of the effect; empty if there is none.
    loads : mapping of str to Pressed
        Known loads by the name of the scan.
    """
    if not on_surfaces(found):
        return None
    numbers = [n for n, i in enumerate(INTERFACES) if f"shape_{i.name}_vertices" in found]
    surfaces = [_surface(found, INTERFACES[number].name) for number in numbers]
    models = [
        (when, title)
        for when, title in titled(dict.fromkeys(WHEN, 0), named)
        if f"local_{when}" in found
    ]
    moved = _moved(found, len(scans), surfaces, models)
    told = [
        BodyScan(
            name,
            loads.get(name, Pressed()),
            moved[scan],
            [
                _gaps(found, scan, number, s.vertices, models)
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
        range_mm(found["local_before"], found["local_before_sd"]),
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
        names = ("scan", *WHEN)[: len(stack)]
        volumes = {n: Volume(v, spacing, (x, y, z)) for n, v in zip(names, stack, strict=True)}
        models = list(titled(dict.fromkeys(names[1:], 0), named))
        pressed = loads.get(name)
        plates = (
            {n: plates_touching(v, pressed.axis) for n, v in volumes.items()} if pressed else {}
        )
        at = middle_mm(volumes["scan"], (Tissue.GLANDULAR,))
        fields = slice_fields(found, scan, volumes, names[1:])
        sets.append(SliceSet(name, volumes, at, plates, fields))
    if not sets:
        return None
    gland = (int(Tissue.GLANDULAR),)
    shown = slice_viewer(
        sets,
        [
            SlicePanel("Scan", "labels", ("scan",)),
            SlicePanel("Model: $choice", "labels", ("$choice",), gland, "scan", tuple(MEANINGS)),
            SlicePanel("Difference: $choice", "overlay", ("scan", "$choice"), gland),
        ],
        VIEWS[:1] if next(iter(sets[0].volumes.values())).values.shape[0] == 1 else VIEWS,
        {int(t): (t.name.lower(), colour) for t, colour in palette.TISSUES.items() if t},
        OVERLAY,
        models,
        MEANINGS,
    )
    return script("slices", shown)


def _surface(found: Arrays, name: str) -> BodySurface:
    vertices, triangles = (found[f"shape_{name}_{part}"] for part in PARTS)
    return BodySurface(name, palette.INTERFACES[name], np.asarray(vertices, np.float64), triangles)


def _moved(
    found: Arrays, scans: int, surfaces: Sequence[BodySurface], models: Sequence[tuple[str, str]]
) -> list[list[dict[str, FloatArray]]]:
    """Return the displaced vertices in each scan, by surface and model.

    They are interpolated from the known points in one call, because most of the time is spent on
    finding neighbours, which are the same for all scans and models.
    """
    points = np.asarray(found["points"], np.float64)
    known = [when for when, _ in models if f"moved_{when}" in found]
    if not known or len(points) < NEIGHBOURS:
        return [[{} for _ in surfaces] for _ in range(scans)]
    # (points, scans, models, 3)
    moves = np.stack([found[f"moved_{when}"] - points for when in known], axis=2)
    between = RBFInterpolator(
        points, moves.swapaxes(0, 1), neighbors=NEIGHBOURS, kernel="linear", degree=0
    )
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    moved = vertices[:, None, None] + between(vertices)
    ends = np.cumsum([len(surface.vertices) for surface in surfaces])
    parts = np.split(moved, ends[:-1])
    return [
        [{when: part[:, scan, k] for k, when in enumerate(known)} for part in parts]
        for scan in range(scans)
    ]


def _gaps(
    found: Arrays,
    scan: int,
    number: int,
    vertices: FloatArray,
    models: Sequence[tuple[str, str]],
) -> dict[str, FloatArray]:
    """Return residuals at vertices, zero if within the noise and nan where no point is near."""
    own = np.asarray(found["interface"]) == number
    if not own.any():
        return {}
    near = min(NEAREST, int(own.sum()))
    near_ones = KDTree(found["points"][own]).query(vertices, near)
    away, which = (np.asarray(one).reshape(-1, near) for one in near_ones)
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
