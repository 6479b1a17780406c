"""Whether the bodies of a breast study can be one breast before and under compression.

What is refused here would be searched to the end, and be explained by wrong constants.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from storage.errors import InputError
from storage.values import Tissue, Volume
from workers.body.mesh.node_count import check_node_count, check_node_count_of
from workers.organs.breast.case_checks import (
    THICKNESS_VOXELS,
    Scan,
    check_outline,
    check_place,
    check_shares,
    check_side,
    check_volume,
)
from workers.organs.breast.problem import compression_axis, extent_of
from workers.organs.breast.spec import BreastCase, BreastScore, BreastTarget, PhantomSpec
from workers.organs.study_checks import Finding

# The longest side of a breast on its chest wall, in mm, and what no body has at all.
USUAL_MM = (50.0, 400.0)
POSSIBLE_MM = (10.0, 2000.0)


class BreastChecks:
    """See `workers.organs.study_checks.StudyChecks`."""

    def of_case(self, case: BreastCase) -> Iterator[Finding]:
        """Say whether a phantom can have so few nodes."""
        phantom = case.reference.phantom
        if phantom is None or case.mesh.nodes is None:
            return
        body = phantom.settings
        shortest = min(body.width_mm, 2 * body.half_width_mm, body.depth_mm)
        try:
            check_node_count(case.mesh.nodes, 1000 * body.outline_ml, shortest)
        except InputError as error:
            yield Finding("impossible", f"case.mesh.nodes: {error}")

    def before_bodies(
        self, case: BreastCase, target: BreastTarget, score: BreastScore
    ) -> Iterator[Finding]:
        """Say which tissues a phantom will lack."""
        phantom = case.reference.phantom
        if phantom is not None:
            yield from _missing(score, _tissues_of(phantom), "The phantom")

    def of_bodies(
        self,
        case: BreastCase,
        target: BreastTarget,
        score: BreastScore,
        reference: Volume | None,
        deformed: Volume | None,
    ) -> Iterator[Finding]:
        """Look at sizes, tissues, and whether two images fit together."""
        axis = compression_axis(case.load.oblique_deg)
        rest = pressed = None
        if reference is not None:
            rest = Scan(_name(case.reference.volume), 0.0, axis, reference)
        if deformed is not None:
            pressed = Scan(_name(target.volume), None, axis, deformed)
        for scan in (rest, pressed):
            if scan is not None:
                yield from _size(scan)
                present = {Tissue(int(t)) for t in np.unique(scan.labels.values)}
                yield from _missing(score, present, scan.file)
        if rest is not None:
            yield from _mesh(case, rest)
            yield from _plates(case, rest)
        if rest is not None and pressed is not None:
            yield from _fit(case, rest, pressed)


CHECKS = BreastChecks()


def _tissues_of(phantom: PhantomSpec) -> set[Tissue]:
    settings = phantom.settings
    present = {Tissue.FAT, Tissue.GLANDULAR}
    if settings.skin_mm > 0:
        present.add(Tissue.SKIN)
    if settings.ligament_mm > 0:
        present.add(Tissue.LIGAMENT)
    return present


def _missing(score: BreastScore, present: set[Tissue], where: str) -> Iterator[Finding]:
    there = ", ".join(t.name.lower() for t in sorted(present) if t != Tissue.AIR)
    for tissue in score.tissues:
        if tissue not in present:
            yield Finding(
                "impossible",
                f"score.labels: {tissue.name.lower()} is to be compared, but {where} has none: "
                f"found {there}. Name tissues that both bodies have, or check the label map.",
            )


def _size(scan: Scan) -> Iterator[Finding]:
    z, y, x = np.nonzero(scan.labels.values != Tissue.AIR)
    sides = [
        float(np.ptp(index) + 1) * spacing
        for index, spacing in zip((x, y, z), scan.labels.spacing_mm, strict=True)
    ]
    longest = max(sides)
    if USUAL_MM[0] <= longest <= USUAL_MM[1]:
        return
    voxel = " x ".join(f"{s:g}" for s in scan.labels.spacing_mm)
    size = " x ".join(f"{s:.3g}" for s in sides)
    possible = POSSIBLE_MM[0] <= longest <= POSSIBLE_MM[1]
    yield Finding(
        "warning" if possible else "implausible",
        f"The body in {scan.file} is {size} mm, in voxels of {voxel} mm; a breast is "
        f"{USUAL_MM[0]:g} to {USUAL_MM[1]:g} mm long. State its spacing_mm in mm.",
    )


def _mesh(case: BreastCase, rest: Scan) -> Iterator[Finding]:
    if case.mesh.nodes is not None:
        try:
            check_node_count_of(case.mesh.nodes, rest.labels)
        except InputError as error:
            yield Finding("impossible", f"case.mesh.nodes: {error}")


def _plates(case: BreastCase, rest: Scan) -> Iterator[Finding]:
    distance = case.load.plate_distance_mm
    if distance is None or distance.final is None:
        return
    thick = _thickness_mm(case, rest.labels)
    if distance.final >= thick:
        yield Finding(
            "implausible",
            f"case.load.plate_distance_mm.final is {distance.final:g} mm, but the body is only "
            f"{thick:.1f} mm thick between the plates: they would not touch it. Give the distance "
            "under compression, in mm.",
        )


def _fit(case: BreastCase, rest: Scan, pressed: Scan) -> Iterator[Finding]:
    thick, thin = (_thickness_mm(case, scan.labels) for scan in (rest, pressed))
    slack = THICKNESS_VOXELS * max(*rest.labels.spacing_mm, *pressed.labels.spacing_mm)
    if thin > thick + slack:
        yield Finding(
            "implausible",
            f"The body is {thick:.1f} mm thick between the plates in {rest.file} "
            f"(case.reference), but {thin:.1f} mm in {pressed.file} (target); compression was "
            "expected to make it thinner. Reference and target look exchanged.",
        )
    checks: tuple[Callable[[Scan, Scan], None], ...] = (
        check_volume,
        check_place,
        check_shares,
        check_side,
    )
    found = [_refusal(check_outline, rest), *(_refusal(check, rest, pressed) for check in checks)]
    yield from (Finding("implausible", text) for text in found if text)


def _refusal(check: Callable[..., None], *scans: Scan) -> str:
    """Return why a check refuses; "" if it does not."""
    try:
        check(*scans)
    except InputError as error:
        return str(error)
    return ""


def _thickness_mm(case: BreastCase, labels: Volume) -> float:
    low, high = extent_of(labels, case.load.oblique_deg)
    return high - low


def _name(volume: str | None) -> str:
    return Path(str(volume)).name
