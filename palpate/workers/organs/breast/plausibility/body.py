"""Plausibility checks of a single scan of a breast."""

from collections.abc import Iterator

from palpate.workers.body.images.orient import end_areas_mm2
from palpate.workers.organs.breast.plausibility.scan_facts import BreastFacts, Scan
from palpate.workers.organs.study_checks import Finding

# The longest side of a breast on its chest wall, in mm.
USUAL_MM = (50.0, 400.0)
# In imaging and surgery, breasts have about 50 to 3,000 ml (Huang et al., Med. Phys. 38, 2180,
# 2011: 80 to 2,500 ml in breast CT). The limits also allow a part of a small breast that was cut
# far from the chest wall.
POSSIBLE_ML = (10.0, 5000.0)
# Share of the body below which detached pieces count as specks of the segmentation.
SPECKS = 0.01
# Ratio of the cross-section at the far end of z to that at the chest wall above which z runs the
# wrong way.
REVERSED = 1.5


def check_volume_range(scan: Scan) -> Iterator[Finding]:
    """Reject a body of implausible size, such as one in metres or micrometres."""
    least, most = POSSIBLE_ML
    if not least <= scan.ml <= most:
        yield Finding(
            "implausible",
            f"The body in {scan.file} has a volume of {_number(scan.ml)} ml and measures "
            f"{_size(scan)} mm, in voxels of {scan.sides}; a breast has {least:g} to {most:g} ml. "
            "Give its spacing_mm in mm.",
        )
        return
    longest = max(scan.sides_mm)
    if not USUAL_MM[0] <= longest <= USUAL_MM[1]:
        yield Finding(
            "warning",
            f"The body in {scan.file} measures {_size(scan)} mm, in voxels of {scan.sides}; a "
            f"breast is {USUAL_MM[0]:g} to {USUAL_MM[1]:g} mm long. Give its spacing_mm in mm.",
        )


def check_empty_slices(scan: Scan) -> Iterator[Finding]:
    """Reject a body with unlabelled slices."""
    for axis, empty in scan.empty_slices.items():
        count = scan.body.shape["zyx".index(axis)]
        yield Finding(
            "implausible",
            f"{len(empty)} of the {count} slices along {axis} in {scan.file} show only air, "
            f"although there is tissue on both sides: {_runs(empty)} (counted from 1). Label "
            "them, or interpolate them in the segmentation program.",
        )


def check_pieces(scan: Scan) -> Iterator[Finding]:
    """Reject a body in several pieces, only one of which would be meshed."""
    largest, *others = scan.pieces_ml
    if not others:
        return
    share = sum(others) / scan.ml
    shown = [_number(ml) for ml in (largest, *others)[:4]]
    more = " and smaller ones" if len(others) > 3 else ""
    yield Finding(
        "implausible" if share > SPECKS else "warning",
        f"The body in {scan.file} has {1 + len(others)} separate pieces, of {', '.join(shown)} "
        f"ml{more}; the largest is {1 - share:.1%} of it, and only that one is simulated. "
        "Connect the pieces, or remove what is not the breast.",
    )


def check_chest_wall(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a body at rest that is widest at the end of z where its nipple should be."""
    if facts.rest is None:
        return
    rest = facts.rest
    wall, nipple = end_areas_mm2(rest.labels)
    if nipple > REVERSED * wall:
        yield Finding(
            "implausible",
            f"The body in {rest.file} has a cross-section of {_number(nipple / 100)} cm2 at the "
            f"high end of z and of {_number(wall / 100)} cm2 at the low end, where the chest wall "
            "should be: z seems to run from nipple to chest wall. Reverse z in the axes of all "
            "scans, together with x or y so that left stays left, such as x,y,z to -x,y,-z.",
        )


BODY_CHECKS = (check_volume_range, check_empty_slices, check_pieces)


def _size(scan: Scan) -> str:
    return " x ".join(f"{s:.3g}" for s in scan.sides_mm)


def _number(value: float) -> str:
    return f"{value:.3g}" if value < 1000 or value >= 1e6 else f"{value:,.0f}"


def _runs(numbers: list[int]) -> str:
    """Return ascending numbers as texts such as "3, 7 to 9"."""
    runs: list[tuple[int, int]] = []
    for n in numbers:
        if runs and runs[-1][1] == n - 1:
            runs[-1] = (runs[-1][0], n)
        else:
            runs.append((n, n))
    return ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in runs)
