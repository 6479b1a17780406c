"""Plausibility checks of a breast's scans and loads, the same for studies, diagnoses and plans.

A scan is checked on its own; forces, distances and plates are checked against the scans; a scan at
rest and one under load are checked as a pair in `scan_pair_checks`.
"""

from collections.abc import Callable, Iterator

from palpate.storage.values import Tissue
from palpate.workers.body.images.named_labels import box_words
from palpate.workers.body.images.scan_orientation import end_areas_mm2
from palpate.workers.body.mesh.mesh_hierarchy import VOLUME_TOLERANCE
from palpate.workers.organs.breast.scan_border import check_cuts
from palpate.workers.organs.breast.scan_facts import BreastFacts, PlateLoad, Scan
from palpate.workers.organs.breast.scan_force import check_pressed_thickness
from palpate.workers.organs.breast.scan_pair_checks import (
    check_mirror_image,
    check_moved,
    check_order_of_loads,
    check_outline,
    check_overlap,
    check_places,
    check_rigid_motion,
    check_shares,
    check_thickness,
    check_volumes,
)
from palpate.workers.organs.plausibility_rule import Finding

# The longest side of a breast on its chest wall, in mm.
USUAL_MM = (50.0, 400.0)
# In imaging and surgery, breasts have about 50 to 3,000 ml (Huang et al., Med. Phys. 38, 2180,
# 2011: 80 to 2,500 ml in breast CT). The limits also allow a part of a small breast that was cut
# far from the chest wall.
POSSIBLE_ML = (10.0, 5000.0)
# Share of the body below which detached pieces count as specks of the segmentation.
SPECKS = 0.01
# Share of the body above which enclosed air is refused: the mesh, which has none, may differ by as
# much from its labels.
MOST_AIR = VOLUME_TOLERANCE
# A cube of three voxels a side: less may vanish when labels are moved or blurred.
FEWEST_VOXELS = 27
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


def check_enclosed_air(scan: Scan) -> Iterator[Finding]:
    """Warn of air inside a body, which has none in the model; reject much of it."""
    air = scan.air
    if air is None:
        return
    places = "" if air.places == 1 else f" in {air.places} places, the largest"
    yield Finding(
        "implausible" if air.share > MOST_AIR else "warning",
        f"The body in {scan.file} encloses {_number(air.ml)} ml of air ({air.share:.2%} of "
        f"it){places} at {air.box}. The simulated body is solid there. Give these voxels the label "
        "of their tissue, such as that of fat; label 0 is the air outside the body.",
    )


def check_specks(scan: Scan) -> Iterator[Finding]:
    """Reject glandular tissue of a few voxels; warn of any other tissue."""
    for tissue, count in scan.voxels.items():
        if count < FEWEST_VOXELS:
            yield too_few(scan, tissue)


def too_few(scan: Scan, tissue: Tissue) -> Finding:
    """Return the finding on a tissue of a few voxels."""
    count = scan.voxels[tissue]
    name = tissue.name.lower()
    return Finding(
        "implausible" if tissue == Tissue.GLANDULAR else "warning",
        f"Only {count} voxel{'s' * (count > 1)} in {scan.file} {'are' if count > 1 else 'is'} "
        f"{name}, at {box_words(scan.labels, scan.labels.values == tissue)}: fewer than "
        f"{FEWEST_VOXELS} cannot be compared. Segment all of it, or if it is a slip, give it the "
        "label of the tissue around it.",
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


BODY_CHECKS = (
    check_volume_range,
    check_empty_slices,
    check_pieces,
    check_enclosed_air,
    check_specks,
)


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


# Tolerance of a given plate position relative to a scan.
PLATE_MM, PLATE_VOXELS = 2.0, 2.0
# Gap between plate and body that is allowed at the start: contact and one voxel.
START_MM = 2.0
# Compression, in multiples of the thickness, beyond which a linear estimate is absurd.
ABSURD_STRAIN = 5.0


def check_force(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a force that would hardly move the plates or would crush the body.

    The estimate is linear: force times thickness divided by Young's modulus and mean section.
    """
    if facts.rest is None:
        return
    voxel = max(scan.voxel_mm for scan in facts.scans)
    for load in facts.loads:
        if load.force_n is None:
            continue
        thick = _along(facts.rest, load).thickness_mm
        section_mm2 = 1000 * facts.rest.ml / thick
        soft, stiff = facts.E_mpa
        most = load.force_n / (soft * section_mm2) * thick
        least = load.force_n / (stiff * section_mm2) * thick
        if most < voxel:
            yield Finding(
                "implausible",
                f"{load.where}: {load.force_n:g} N moves the plates by about {most:.2g} mm (a body "
                f"of {thick:.1f} mm, fat of {1000 * soft:g} kPa), less than one voxel "
                f"({voxel:g} mm): too little to measure. Give the force in N; 1 kN is 1000 N.",
            )
        elif least > ABSURD_STRAIN * thick:
            yield Finding(
                "implausible",
                f"{load.where}: {load.force_n:g} N would press a body of {thick:.1f} mm by "
                f"{least / thick:.2g} times its thickness (fat of {1000 * stiff:g} kPa). "
                "Mammography uses 50 to 200 N. Give the force in N.",
            )


def check_distance(facts: BreastFacts) -> Iterator[Finding]:
    """Reject plates whose given distance differs from the thickness of the bodies."""
    scans = {id(load): scan for scan, load in facts.pressed}
    for load in facts.loads:
        rest = None if facts.rest is None else _along(facts.rest, load)
        scan = scans.get(id(load))
        distance = load.distance_mm
        if load.ends_mm is not None:
            distance = load.ends_mm[1] - load.ends_mm[0]
        if rest is not None and distance is not None and distance >= rest.thickness_mm:
            yield Finding(
                "implausible",
                f"{load.where} is {distance:g} mm, but the body is only {rest.thickness_mm:.1f} mm "
                f"thick between the plates in {rest.file}: they would not touch it. Give the "
                "distance under compression, in mm.",
            )
        elif scan is not None and distance is not None and _off(distance, scan) > _slack(scan):
            yield Finding(
                "implausible",
                f"{load.where} is {distance:g} mm, but the body is {scan.thickness_mm:.1f} mm "
                f"thick between the plates in {scan.file}; a difference of at most "
                f"{_slack(scan):g} mm was expected. Give the distance at which that scan was made, "
                "in mm.",
            )
        if rest is not None and load.initial_mm is not None:
            off = abs(load.initial_mm - rest.thickness_mm)
            if off > _slack(rest):
                yield Finding(
                    "warning",
                    f"{load.where}: the plates start {load.initial_mm:g} mm apart, but the body is "
                    f"{rest.thickness_mm:.1f} mm thick in {rest.file}. The initial distance is not "
                    "used.",
                )


def check_plates(facts: BreastFacts) -> Iterator[Finding]:
    """Reject plates that start off the body, or end away from the body in the scan."""
    for load in facts.loads:
        if facts.rest is not None and load.starts_mm is not None:
            yield from _start(load, _along(facts.rest, load), *load.starts_mm)
    for scan, load in facts.pressed:
        if load.ends_mm is None:
            continue
        for name, plate, end in zip(("lower", "upper"), load.ends_mm, scan.extent_mm, strict=True):
            if abs(plate - end) > _slack(scan):
                yield Finding(
                    "implausible",
                    f"{load.where}: the {name} plate ends at {plate:g} mm, but the body in "
                    f"{scan.file} ends at {end:.1f} mm, {abs(plate - end):.1f} mm away. Give the "
                    "positions of the plates in the frame of the scan, or omit them: they are then "
                    "taken from the scan.",
                )


def _start(
    load: PlateLoad, rest: Scan, where: str, lower: float, upper: float
) -> Iterator[Finding]:
    low, high = rest.extent_mm
    for name, gap, plate, end in (
        ("lower", low - lower, lower, low),
        ("upper", upper - high, upper, high),
    ):
        if abs(gap) <= START_MM + rest.voxel_mm:
            continue
        place = "off" if gap > 0 else "inside"
        yield Finding(
            "implausible",
            f"{where}: the {name} plate starts {abs(gap):.1f} mm {place} the body ({plate:g} mm; "
            f"the body in {rest.file} ends at {end:.1f} mm along the compression). Give the "
            "position at which the plate first touches the body, or omit it: it is then taken from "
            "the scan.",
        )


def _along(rest: Scan, load: PlateLoad) -> Scan:
    return rest if rest.axis == load.axis else Scan(rest.file, 0.0, load.axis, rest.labels)


def _off(distance: float, scan: Scan) -> float:
    """Return the difference between a distance and the thickness, ignoring bulges."""
    return min(abs(distance - scan.thickness_mm), abs(distance - scan.median_thickness_mm))


def _slack(scan: Scan) -> float:
    return max(PLATE_MM, PLATE_VOXELS * scan.voxel_mm)


Check = Callable[[BreastFacts], Iterator[Finding]]


def check_bodies(facts: BreastFacts) -> Iterator[Finding]:
    """Check each scan on its own."""
    for scan in facts.scans:
        for check in BODY_CHECKS:
            yield from check(scan)


# A group is checked only if no earlier one rejects the input: its findings would be consequences.
SCAN_CHECKS: tuple[tuple[Check, ...], ...] = (
    (check_bodies, check_chest_wall, check_outline, check_volumes),
    (check_places, check_thickness),
    (
        check_force,
        check_pressed_thickness,
        check_distance,
        check_plates,
        check_moved,
        check_overlap,
        check_shares,
        check_mirror_image,
        check_order_of_loads,
    ),
    (check_cuts, check_rigid_motion),
)


def findings_of(facts: BreastFacts) -> Iterator[Finding]:
    """Yield the findings of the checks, up to the first group that rejects the input."""
    for group in SCAN_CHECKS:
        found = [finding for check in group for finding in check(facts)]
        yield from found
        if any(finding.severity != "warning" for finding in found):
            return
