"""Data of the 3-D viewer of a page; see scripts/body.js.

They are surfaces at rest and under load, their colours, and the loads on the body: plates, arrows
of their forces, the chest wall.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.service.formatting import number
from palpate.service.report.drawing.colour_scale import SIGNED
from palpate.service.report.drawing.packed import Json, packed, packed_points, packed_triangles
from palpate.service.report.drawing.palette import SEQUENTIAL
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.pressed import Pressed

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
        "choices": [list(one) for one in choices],
        "states": [list(one) for one in states],
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
    found: list[Json] = []
    lengths = [
        np.linalg.norm(moved - surface.vertices, axis=1)
        for scan in scans
        for surface, models in zip(surfaces, scan.moved, strict=True)
        for moved in models.values()
    ]
    if lengths:
        most = max(float(length.max()) for length in lengths)
        found.append(
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
        found = [gap, *found] if first == "gap" else [*found, gap]
    return [*found, {"key": "plain", "title": "plain"}]


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
