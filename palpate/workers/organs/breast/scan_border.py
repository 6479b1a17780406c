"""Tissue of a breast that is cut off by the border of its image.

The chest wall, the low end of z, is always a cut and does not count. A body that ends inside its
image, or exactly at its border, grows from its end: at the border it has a small part of its
section deeper inside. A body that was cut has nearly all of it.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from palpate.storage.values import Tissue, Volume
from palpate.workers.organs.breast.scan_facts import AXES, BreastFacts, Scan
from palpate.workers.organs.plausibility_rule import Finding

# Depth at which the section of a body is compared with that at the border, in mm, and the share of
# it above which the body was cut: a round body that ends at the border has 0.1 to 0.3 in voxels of
# 1 to 4 mm; one of which 6 mm are missing has 0.4.
DEPTH_MM, CUT_SHARE = 10.0, 0.4
# Smaller areas on the border are specks.
LEAST_MM2 = 100.0
# Cosine of the angle between the compression and an axis above which its faces are plates, where a
# body that fills its image is flat without a cut.
PLATE_COSINE = 0.7


def cut_cm2(labels: Volume) -> dict[str, float]:
    """Return the section of the body on each face of the image that cuts it, by name.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels with the air of the image around the body, or one voxel of it.
    """
    cut: dict[str, float] = {}
    for number, axis in enumerate(AXES):
        planes = np.moveaxis(labels.values, 2 - number, 0)
        sides = [s for n, s in enumerate(labels.spacing_mm) if n != number]
        depth = max(2, round(DEPTH_MM / labels.spacing_mm[number]))
        if len(planes) <= 2 * depth:
            continue
        for end, first, inner in (("low", 0, depth), ("high", -1, -1 - depth)):
            if (axis, end) == ("z", "low"):
                continue
            area, inside = (
                float(np.count_nonzero(planes[k] != Tissue.AIR)) * sides[0] * sides[1]
                for k in (first, inner)
            )
            if area > max(LEAST_MM2, CUT_SHARE * inside):
                cut[f"{end} {axis}"] = area / 100
    return cut


def cut_of(scan: Scan) -> Mapping[str, float]:
    """Return the faces that cut a scan, as measured before its image was moved if known."""
    return cut_cm2(scan.labels) if scan.cut_cm2 is None else scan.cut_cm2


def check_cut(scan: Scan) -> Iterator[Finding]:
    """Warn of a body that is cut off by the border of its image."""
    yield from _warning(scan, cut_of(scan))


def check_cuts(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a pair of which only one scan is cut off at a face; warn if both are."""
    rest = facts.rest
    at_rest = {} if rest is None else cut_of(rest)
    if rest is not None:
        yield from _warning(rest, at_rest)
    for scan, _ in facts.pressed:
        pressed, beside = cut_of(scan), _beside_plates(scan)
        yield from _warning(scan, beside)
        if rest is not None:
            certain = not facts.aligned or scan.cut_cm2 is not None
            yield from _in_one(rest, at_rest, scan, pressed, certain)
            yield from _in_one(scan, beside, rest, at_rest, certain)


def cut_text(scan: Scan) -> str:
    """Return a sentence on the faces beside the plates that cut a scan; empty if none does."""
    cut = _beside_plates(scan)
    return f"{scan.file} is cut off by its border, with {_listed(cut)}." if cut else ""


def _beside_plates(scan: Scan) -> dict[str, float]:
    plates = [axis for axis, c in zip(AXES, scan.axis, strict=True) if abs(c) > PLATE_COSINE]
    return {face: cm2 for face, cm2 in cut_of(scan).items() if face[-1] not in plates}


def _warning(scan: Scan, cut: Mapping[str, float]) -> Iterator[Finding]:
    if cut:
        yield Finding(
            "warning",
            f"The body in {scan.file} reaches the border of its image, with {_listed(cut)}. Unless "
            "a plate is there, the breast is cut off: what is beyond counts as air, and the cut as "
            "free skin. Export the image with all of the breast and some air around it.",
        )


def _in_one(
    scan: Scan, cut: Mapping[str, float], other: Scan, whole: Mapping[str, float], certain: bool
) -> Iterator[Finding]:
    """Reject faces that cut a scan and not the other one."""
    here = {face: cm2 for face, cm2 in cut.items() if face not in whole}
    if here and certain:
        yield Finding(
            "implausible",
            f"The body in {scan.file} is cut off by the border of its image, with {_listed(here)}, "
            f"but the one in {other.file} is whole there: they do not show the same tissue. Export "
            f"{scan.file} with all of the breast and some air around it.",
        )


def _listed(cut: Mapping[str, float]) -> str:
    faces = [f"{cm2:.3g} cm2 of tissue on its face at {face}" for face, cm2 in cut.items()]
    return " and ".join(faces)
