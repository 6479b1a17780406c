"""Says what the slice viewer of a page shows; see scripts/slices.js."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from palpate.service.report.drawing.packed import Json, body_box_mm, packed_volume, thinned
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
    """

    title: str
    kind: str
    volumes: tuple[str, ...]
    tissues: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class SliceSet:
    """The volumes of one scan by name, and the place where slices begin, (x, y, z) in mm."""

    name: str
    volumes: Mapping[str, Volume]
    at_mm: Triple


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
            {"title": p.title, "kind": p.kind, "volumes": p.volumes, "tissues": p.tissues}
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
    }


def _set(one: SliceSet) -> Json:
    thin = {name: thinned(volume) for name, volume in one.volumes.items()}
    boxes = [body_box_mm(volume) for volume in thin.values()]
    box = [
        [min(b[0][k] for b in boxes) - MARGIN_MM, max(b[1][k] for b in boxes) + MARGIN_MM]
        for k in range(3)
    ]
    return {
        "name": one.name,
        "volumes": {name: packed_volume(volume) for name, volume in thin.items()},
        "at": list(one.at_mm),
        "box": box,
    }
