"""Alignment of the loaded scans of a case with its scan at rest."""

from palpate.workers.body.images.largest_component import in_air
from palpate.workers.organs.breast.case.scanned_case import ScannedCase, stated_starts_mm
from palpate.workers.organs.breast.case.spec import CaseLoad
from palpate.workers.organs.breast.plausibility.alignment import aligned
from palpate.workers.organs.breast.plausibility.extents import unit_axis
from palpate.workers.organs.breast.plausibility.scan_facts import PlateLoad


def aligned_case(case: ScannedCase) -> ScannedCase:
    """Return a case whose loaded scans are in the frame of the scan at rest."""
    loaded, words = [], []
    for number, (load, scan) in enumerate(zip(case.loads, case.deformed, strict=True)):
        labels, motion = aligned(case.reference, scan, case_load(case, number))
        loaded.append(in_air(labels))
        words.append(
            f"{load.volume} was aligned with {case.file.scans.reference}: moved by {motion.words}."
        )
    return ScannedCase(case.file, case.reference, case.repeat, loaded, case.where, words)


def case_load(case: ScannedCase, number: int) -> PlateLoad:
    """Return one load of a case in the form used by the checks."""
    stated, where = case.loads[number], f"scans.loads, {case.loads[number].volume}"
    axis = unit_axis(stated.axis)
    if stated.force_n is not None:
        return PlateLoad(where, axis, force_n=stated.force_n, starts_mm=_starts(case, stated))
    ends = None
    if stated.lower_mm is not None and stated.upper_mm is not None:
        ends = stated.lower_mm, stated.upper_mm
    distance = None if ends is not None else stated.plate_distance_mm
    return PlateLoad(f"{where}, plate_distance_mm", axis, distance_mm=distance, ends_mm=ends)


def _starts(case: ScannedCase, load: CaseLoad) -> tuple[str, float, float] | None:
    """Return the initial positions of the plates of a force; None if the file gives none."""
    if stated_starts_mm(case.file, load) == (None, None):
        return None
    own = load.lower_mm is not None and load.upper_mm is not None
    where = f"scans.loads, {load.volume}" if own else "plates"
    low, high = case.plate_starts_mm(load)
    return where, low, high
