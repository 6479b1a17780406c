"""Plausibility checks of forces, distances and plates against the scans of a breast."""

from collections.abc import Iterator

from palpate.workers.organs.breast.plausibility.scan_facts import BreastFacts, PlateLoad, Scan
from palpate.workers.organs.study_checks import Finding

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
