"""Data of the slice viewer of a page; see scripts/slices.js."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from palpate.service.report.drawing.packed import Json, body_box_mm, packed_volume, thinned
from palpate.service.report.drawing.palette import SEQUENTIAL
from palpate.service.report.drawing.plates import Plates
from palpate.service.report.drawing.slices import View
from palpate.storage.values import Triple, Volume

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
        "sets": [_set(one) for one in sets],
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
        "differences": [list(one) for one in differences],
        "choices": [list(one) for one in choices],
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
