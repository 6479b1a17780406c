"""Says what the slice viewer of a page shows; see scripts/slices.js."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.service.report.drawing.colour_scale import SEQUENTIAL
from palpate.service.report.drawing.packed import Json, body_box_mm, packed_volume, thinned
from palpate.service.report.drawing.plates import Plates
from palpate.service.report.drawing.slices import View
from palpate.storage.values import Triple, Volume

HINT = "Move the slider, or focus it and use the arrow keys. Point at a slice to read it."
FLAT_HINT = "Point at the section to read it."
MARGIN_MM = 3.0


@dataclass(frozen=True)
class SlicePanel:
    """One slice of the viewer.

    Parameters
    ----------
    title : str
        ``$choice`` stands for the model that is chosen.
    kind : {"labels", "difference", "overlay"}
    volumes : tuple of str
        One, or two that are compared; ``$choice`` as above.
    tissues : tuple of int
        That are compared; of an overlay, the gland.
    outline : str
        A volume whose outline, and that of its `tissues`, is drawn over the slice; empty for none.
    coloured : str
        A field by which the slice can be coloured instead; empty for none.
    """

    title: str
    kind: str
    volumes: tuple[str, ...]
    tissues: tuple[int, ...] = ()
    outline: str = ""
    coloured: str = ""


@dataclass(frozen=True, eq=False)
class SliceSet:
    """The volumes of one scan by name, and the place where slices begin, (x, y, z) in mm.

    Parameters
    ----------
    name : str
    volumes : mapping of str to Volume
    at_mm : tuple of float
    plates : mapping of str to Plates
        Between which a volume lies.
    fields : mapping of str to Volume
        Lengths in mm, nan where there is no tissue.
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
) -> Json:
    """Return what the slice viewer shows, which `script` puts into a page as "slices".

    Parameters
    ----------
    sets : sequence of SliceSet
    panels : sequence of SlicePanel
        Those whose volumes are there are shown.
    views : sequence of View
    labels : mapping of int to (str, str)
        Name and colour of each label.
    differences : sequence of (str, str)
        Meaning and colour: outside, rest of the body, in both, in the first, in the second.
    choices : sequence of (str, str)
        Names of volumes that stand for ``$choice``, and their titles.
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
    }


def _set(one: SliceSet) -> Json:
    thin = {name: thinned(volume) for name, volume in one.volumes.items()}
    boxes = [body_box_mm(volume) for volume in thin.values()]
    steps = next(iter(thin.values())).spacing_mm
    # Whole voxels: slices are then drawn voxel by voxel, and none is skipped.
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
        "fields": {name: _field(lengths) for name, lengths in one.fields.items()},
        "at": list(one.at_mm),
        "box": box,
    }


def _field(lengths: Volume) -> Json:
    """Return lengths in 254 steps from 0 to their end; 0 where they are not known."""
    known = np.isfinite(lengths.values)
    end = max(float(lengths.values[known].max(initial=0.0)), 0.01)
    steps = np.where(known, 1 + np.rint(np.nan_to_num(lengths.values) / end * 254), 0)
    shown = replace(lengths, values=steps.astype(np.uint8))
    return packed_volume(shown) | {"end": round(end, 2)}
