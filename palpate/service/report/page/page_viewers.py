"""What the two viewers of a page show; `scripts/slices.js` and `scripts/body.js` draw it.

The slice viewer shows volumes. The other turns a body: surfaces at rest and under load, their
colours, and the loads: plates, arrows of their forces, the chest wall.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from palpate.service.number_formatting import number
from palpate.service.report.drawing.colours import SEQUENTIAL, SIGNED
from palpate.service.report.drawing.volume_sections import Plates, View
from palpate.service.report.page.page_elements import (
    Json,
    body_box_mm,
    packed,
    packed_points,
    packed_triangles,
    packed_volume,
    thinned,
)
from palpate.storage.values import FloatArray, IntArray, Triple, Volume
from palpate.workers.mechanics.fem.loads_and_regions import Pressed

HINT = "Move the slider, or focus it and use the arrow keys. Point at a slice to read its values."
FLAT_HINT = "Point at the section to read its values."
MARGIN_MM = 3.0


@dataclass(frozen=True)
class SlicePanel:
    """One slice of the viewer.

    Parameters
    ----------
    title : str
        ``$choice`` is replaced by the chosen model.
    kind : {"labels", "difference", "overlay"}
    volumes : tuple of str
        One volume, or two to compare; ``$choice`` as above.
    tissues : tuple of int
        Compared tissues; for an overlay, the gland.
    outline : str
        A volume whose outline and `tissues` outlines are drawn over the slice; empty for none.
    coloured : tuple of str
        Fields available for colouring the slice.
    """

    title: str
    kind: str
    volumes: tuple[str, ...]
    tissues: tuple[int, ...] = ()
    outline: str = ""
    coloured: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class SliceSet:
    """The volumes of one scan by name, and the initial position of slices, (x, y, z) in mm.

    Parameters
    ----------
    name : str
    volumes : mapping of str to Volume
    at_mm : tuple of float
    plates : mapping of str to Plates
        Plates around a volume.
    fields : mapping of str to Volume
        Lengths in mm by name, or by ``NAME:CHOICE`` for one model; nan if unknown. Fields
        with the same name share a scale.
    """

    name: str
    volumes: Mapping[str, Volume]
    at_mm: Triple
    plates: Mapping[str, Plates] = field(default_factory=dict)
    fields: Mapping[str, Volume] = field(default_factory=dict)


def slice_viewer(
    sets: Sequence[SliceSet],
    panels: Sequence[SlicePanel],
    views: Sequence[View],
    labels: Mapping[int, tuple[str, str]],
    differences: Sequence[tuple[str, str]],
    choices: Sequence[tuple[str, str]] = (),
    meanings: Mapping[str, str] = MappingProxyType({}),
) -> Json:
    """Return the data of the slice viewer, which `script` puts into a page as "slices".

    Parameters
    ----------
    sets : sequence of SliceSet
    panels : sequence of SlicePanel
        Panels without volumes are skipped.
    views : sequence of View
    labels : mapping of int to (str, str)
        Name and colour of each label.
    differences : sequence of (str, str)
        Meaning and colour: outside, rest of the body, in both, in the first, in the second.
    choices : sequence of (str, str)
        Values of ``$choice``, and their titles.
    meanings : mapping of str to str
        Description of each field.
    """
    flat = len(views) == 1
    return {
        "sets": [_set(entry) for entry in sets],
        "panels": [
            {
                "title": p.title,
                "kind": p.kind,
                "volumes": p.volumes,
                "tissues": p.tissues,
                "outline": p.outline,
                "coloured": p.coloured,
            }
            for p in panels
        ],
        "views": [
            {"name": v.name, "normal": v.normal, "across": v.across, "up": v.up} for v in views
        ],
        "labels": {str(label): list(told) for label, told in labels.items()},
        "differences": [list(entry) for entry in differences],
        "choices": [list(entry) for entry in choices],
        "hint": FLAT_HINT if flat else HINT,
        "flat": flat,
        "stops": SEQUENTIAL,
        "meanings": dict(meanings),
    }


def _set(one: SliceSet) -> Json:
    thin = {name: thinned(volume) for name, volume in one.volumes.items()}
    boxes = [body_box_mm(volume) for volume in thin.values()]
    steps = next(iter(thin.values())).spacing_mm
    # Whole voxels: slices are drawn voxel by voxel, without gaps.
    room = [step * math.ceil(MARGIN_MM / step) for step in steps]
    box = [
        [min(b[0][k] for b in boxes) - room[k], max(b[1][k] for b in boxes) + room[k]]
        for k in range(3)
    ]
    return {
        "name": one.name,
        "volumes": {name: packed_volume(volume) for name, volume in thin.items()},
        "plates": {
            name: {"axis": plates.axis, "heights": plates.heights_mm}
            for name, plates in one.plates.items()
        },
        "fields": {name: _field(lengths, _end(name, one)) for name, lengths in one.fields.items()},
        "at": list(one.at_mm),
        "box": box,
    }


def _end(field: str, one: SliceSet) -> float:
    """Return the largest length in all fields with this name."""
    name = field.partition(":")[0]
    alike = (lengths.values for key, lengths in one.fields.items() if key.partition(":")[0] == name)
    return max(0.01, *(float(np.nanmax(v, initial=0.0)) for v in alike))


def _field(lengths: Volume, end: float) -> Json:
    """Return lengths quantised to 254 steps; 0 if unknown."""
    known = np.isfinite(lengths.values)
    steps = np.where(known, 1 + np.rint(np.nan_to_num(lengths.values) / end * 254), 0)
    shown = replace(lengths, values=steps.astype(np.uint8))
    return packed_volume(shown) | {"end": round(end, 2)}


# Overhang of plates and wall, and length of arrows, relative to the size of the body.
BEYOND, ARROW = 0.1, 0.22


@dataclass(frozen=True, eq=False)
class BodySurface:
    """A triangulated interface at rest: vertices (n, 3) in mm, triangles (m, 3)."""

    name: str
    colour: str
    vertices: FloatArray
    triangles: IntArray


@dataclass(frozen=True, eq=False)
class BodyScan:
    """The surfaces under one load, in their order.

    Parameters
    ----------
    name : str
    pressed : Pressed
    moved : sequence of mapping of str to ndarray, shape (n, 3)
        Vertices under load by the name of the model; empty if unknown.
    gap : sequence of mapping of str to ndarray, shape (n,)
        Signed distance in mm from the observed surface, by the name of the model; nan if
        unknown. Positive if the model is outside.
    """

    name: str
    pressed: Pressed
    moved: Sequence[Mapping[str, FloatArray]]
    gap: Sequence[Mapping[str, FloatArray]] = field(default_factory=tuple)


def body_viewer(
    surfaces: Sequence[BodySurface],
    scans: Sequence[BodyScan],
    choices: Sequence[tuple[str, str]],
    gap_about: str,
    gap_mm: float | None = None,
    first: str = "displacement",
) -> Json:
    """Return the data of the 3-D viewer, which `script` puts into a page as "body".

    Parameters
    ----------
    surfaces : sequence of BodySurface
        The outline first.
    scans : sequence of BodyScan
    choices : sequence of (str, str)
        Models by name, and their titles.
    gap_about : str
        Meaning of the colours of the gap.
    gap_mm : float, optional
        End of their scale.
    first : {"displacement", "gap"}
        Initial quantity of the colours: displacement or gap.
    """
    outline = surfaces[0].vertices
    moved = [m for scan in scans for m in scan.moved[0].values()] if scans else []
    every = np.concatenate([outline, *moved])
    low, high = every.min(axis=0), every.max(axis=0)
    size = float(np.linalg.norm(high - low))
    states = [("loaded", "under load"), ("rest", "before")] if moved else [("rest", "before")]
    return {
        "surfaces": [
            {
                "name": s.name,
                "colour": s.colour,
                "rest": packed_points(s.vertices),
                "triangles": packed_triangles(s.triangles),
            }
            for s in surfaces
        ],
        "sets": [_scan(scan, outline, size) for scan in scans],
        "choices": [list(pair) for pair in choices],
        "states": [list(pair) for pair in states],
        "colourings": _colourings(scans, surfaces, gap_about, gap_mm, first),
        "middle": ((low + high) / 2).round(2).tolist(),
        "reach": [round(0.98 * size, 2), round(0.88 * size, 2)],
    }


def _colourings(
    scans: Sequence[BodyScan],
    surfaces: Sequence[BodySurface],
    gap_about: str,
    gap_mm: float | None,
    first: str,
) -> list[Json]:
    colourings: list[Json] = []
    lengths = [
        np.linalg.norm(moved - surface.vertices, axis=1)
        for scan in scans
        for surface, models in zip(surfaces, scan.moved, strict=True)
        for moved in models.values()
    ]
    if lengths:
        most = max(float(length.max()) for length in lengths)
        colourings.append(
            {
                "key": "displacement",
                "title": "displacement",
                "range": [0.0, round(most, 2)],
                "stops": SEQUENTIAL,
                "about": "displacement of the simulated surface",
            }
        )
    gaps = [g[np.isfinite(g)] for scan in scans for models in scan.gap for g in models.values()]
    if any(g.size for g in gaps):
        most = gap_mm or max(0.05, float(np.quantile(np.abs(np.concatenate(gaps)), 0.98)))
        gap: Json = {
            "key": "gap",
            "title": "gap",
            "range": [-round(most, 2), round(most, 2)],
            "stops": SIGNED,
            "about": gap_about,
        }
        colourings = [gap, *colourings] if first == "gap" else [*colourings, gap]
    return [*colourings, {"key": "plain", "title": "plain"}]


def _scan(scan: BodyScan, rest: FloatArray, size: float) -> Json:
    loaded = next(iter(scan.moved[0].values()), None)
    stages = {"rest": _stage(rest, scan.pressed, size, loads=False)}
    stages["loaded"] = _stage(rest if loaded is None else loaded, scan.pressed, size, loads=True)
    return {
        "name": scan.name,
        "stages": stages,
        "surfaces": [
            {
                "moved": {key: packed_points(value) for key, value in models.items()},
                "gap": {key: packed(np.round(g, 3), "f4") for key, g in gaps.items()},
            }
            for models, gaps in zip(scan.moved, scan.gap or [{}] * len(scan.moved), strict=True)
        ],
    }


def _stage(vertices: FloatArray, pressed: Pressed, size: float, loads: bool) -> Json:
    """Return plates that touch the body, the chest wall below it, and the arrows of the load."""
    axis = np.asarray(pressed.axis) / np.linalg.norm(pressed.axis)
    deep = np.array([0.0, 0.0, 1.0])
    wide = np.cross(axis, deep)
    along, across, depth = vertices @ axis, vertices @ wide, vertices @ deep
    beyond = BEYOND * size
    ends = across.min() - beyond, across.max() + beyond
    floor, top = depth.min(), depth.max() + 0.5 * beyond
    sheets, arrows, labels = [], [], []
    for height, way in ((along.min(), 1.0), (along.max(), -1.0)):
        corners = [
            height * axis + a * wide + d * deep
            for a, d in ((ends[0], floor), (ends[1], floor), (ends[1], top), (ends[0], top))
        ]
        sheets.append({"kind": "plate", "corners": _rounded(corners)})
        if not loads:
            continue
        tip = height * axis + across.mean() * wide + (floor + 0.55 * (top - floor)) * deep
        tail = tip - way * ARROW * size * axis
        arrows.append({"from": _rounded(tail), "to": _rounded(tip)})
        if pressed.force_n is not None:
            text = f"{number(pressed.force_n, 3)} N"
            labels.append(
                {"text": text, "at": _rounded(tail - way * 0.03 * size * axis), "kind": "load"}
            )
    low, high = along.min() - beyond, along.max() + beyond
    wall = [
        h * axis + a * wide + floor * deep
        for a, h in ((ends[0], low), (ends[1], low), (ends[1], high), (ends[0], high))
    ]
    sheets.append({"kind": "wall", "corners": _rounded(wall)})
    below = wall[0] - 0.03 * size * axis
    labels.append({"text": "chest wall", "at": _rounded(below), "kind": "wall"})
    plate = "plate" if pressed.force_n is not None else "plate, held at a given distance"
    before = along.max() * axis + ends[1] * wide + (top + 0.05 * size) * deep
    labels.append({"text": plate, "at": _rounded(before), "kind": "plate"})
    return {"sheets": sheets, "arrows": arrows, "labels": labels}


def _rounded(points: object) -> list[object]:
    rounded: list[object] = np.round(np.asarray(points, float), 2).tolist()
    return rounded
