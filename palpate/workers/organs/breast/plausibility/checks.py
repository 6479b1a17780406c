"""Plausibility checks of a breast, the same for studies, diagnoses and plans."""

from collections.abc import Callable, Iterator

from palpate.workers.organs.breast.plausibility.body import BODY_CHECKS, check_chest_wall
from palpate.workers.organs.breast.plausibility.loads import (
    check_distance,
    check_force,
    check_plates,
)
from palpate.workers.organs.breast.plausibility.pairs import (
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
from palpate.workers.organs.breast.plausibility.scan_facts import BreastFacts
from palpate.workers.organs.study_checks import Finding

Check = Callable[[BreastFacts], Iterator[Finding]]


def check_bodies(facts: BreastFacts) -> Iterator[Finding]:
    """Check each scan on its own."""
    for scan in facts.scans:
        for check in BODY_CHECKS:
            yield from check(scan)


# A group is checked only if no earlier one rejects the input: its findings would be consequences.
CHECKS: tuple[tuple[Check, ...], ...] = (
    (check_bodies, check_chest_wall, check_outline, check_volumes),
    (check_places, check_thickness),
    (
        check_force,
        check_distance,
        check_plates,
        check_moved,
        check_overlap,
        check_shares,
        check_mirror_image,
        check_order_of_loads,
    ),
    (check_rigid_motion,),
)


def findings_of(facts: BreastFacts) -> Iterator[Finding]:
    """Yield the findings of the checks, up to the first group that rejects the input."""
    for group in CHECKS:
        found = [finding for check in group for finding in check(facts)]
        yield from found
        if any(finding.severity != "warning" for finding in found):
            return
