"""Plausibility checks of a cornea's section and frames, before the first task of a study.

A frame that passes wrongly would be searched to the end and explained by wrong constants.
"""

from collections.abc import Iterator
from pathlib import Path

from palpate.workers.organs.cornea.frames.checks import Imaged, check_frame, check_under_jet
from palpate.workers.organs.cornea.pair_checks import check_pair, exchanged
from palpate.workers.organs.cornea.plausible import (
    CENTRAL_MM,
    IOP_MMHG,
    JET_KPA,
    RADIUS_MM,
    WIDTH_MM,
    Range,
)
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.spec import CorneaCase, CorneaScore, CorneaTarget, FrameSpec
from palpate.workers.organs.study_checks import Finding


class CorneaChecks:
    """See `workers.organs.study_checks.StudyChecks`."""

    def of_case(self, case: CorneaCase) -> Iterator[Finding]:
        """Check the generated section and the pressures."""
        section, jet = case.reference.section, case.load.jet
        if section is not None:
            where = "case.reference.section"
            yield from _stated(f"{where}.radius_mm", section.radius_mm, RADIUS_MM)
            yield from _stated(f"{where}.central_mm", section.central_mm, CENTRAL_MM)
            yield from _stated(f"{where}.chord_mm", section.chord_mm, WIDTH_MM)
        if case.load.iop_mmhg > 0:
            yield from _stated("case.load.iop_mmhg", case.load.iop_mmhg, IOP_MMHG)
        if jet.pressure_mpa > 0:
            key = "pressure_kpa" if jet.pressure_kpa is not None else "pressure_mmhg"
            unit = JET_KPA if jet.pressure_kpa is not None else JET_KPA.in_mmhg()
            yield from _stated(f"case.load.jet.{key}", getattr(jet, key), unit)

    def before_bodies(
        self, case: CorneaCase, target: CorneaTarget, score: CorneaScore
    ) -> Iterator[Finding]:
        """Check nothing: the model of the file has already rejected contradictions."""
        yield from ()

    def of_bodies(
        self,
        case: CorneaCase,
        target: CorneaTarget | None,
        score: CorneaScore | None,
        reference: Section | None,
        deformed: Section | None,
    ) -> Iterator[Finding]:
        """Check each frame separately, then both as a pair."""
        rest = _imaged("case.reference.frame", case.reference.frame, reference)
        pressed = None
        if target is not None:
            pressed = _imaged("target.frame", target.frame, deformed)
        pair = None if rest is None or pressed is None else (rest, pressed)
        found = [] if pair is None else list(exchanged(*pair))
        if found:
            yield from found
            return
        found += [] if rest is None else check_frame(rest)
        found += [] if pressed is None else check_under_jet(pressed)
        yield from found
        if pair is not None and not _refused(found):
            yield from check_pair(*pair, case)


CHECKS = CorneaChecks()


def _imaged(key: str, spec: FrameSpec | None, section: Section | None) -> Imaged | None:
    if spec is None or section is None:
        return None
    return Imaged(key, Path(spec.file), spec, section)


def _refused(findings: list[Finding]) -> bool:
    return any(finding.severity != "warning" for finding in findings)


def _stated(key: str, value: float, usual: Range) -> Iterator[Finding]:
    if value not in usual:
        yield Finding(
            "implausible",
            f"{key} is {value:g} {usual.unit}; {usual.what} is {usual}. Give it in {usual.unit}.",
        )
