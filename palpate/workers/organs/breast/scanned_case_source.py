"""Segmented scans as the source of a diagnosis, and planned scans as the source of a plan.

Their plausibility is checked from the file of the case and from its scans.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Self

from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.tissue_labels import resample_labels
from palpate.workers.common_keys import validated
from palpate.workers.comparison.similarity_score import jaccard
from palpate.workers.diagnosis.outcome.diagnosis_source import SourceContent
from palpate.workers.diagnosis.outcome.segmented_scans import SegmentedScans
from palpate.workers.diagnosis.problem.planned_acquisition import Acquisition
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.boundary_value_problem import Frame
from palpate.workers.mechanics.fem.loads_and_regions import Pressed
from palpate.workers.mechanics.model_parameters import KPA
from palpate.workers.organs.breast.scan_facts import BreastFacts, Scan, Tissues, unit_axis
from palpate.workers.organs.breast.scan_plausibility import findings_of
from palpate.workers.organs.breast.scanned_case import ScannedCase, acquisition_of, case_load
from palpate.workers.organs.breast.scanned_case_keys import ALONG_Y, CaseFile
from palpate.workers.organs.plausibility_rule import Finding

# Minimum Jaccard coefficient of the glandular tissue in two segmentations of one scan.
SAME_GLAND = 0.5
# Swelling is a cause that a diagnosis can find: 12 % of gland that fills a third of a body.
SWELLING = 0.04


def case_findings(case: ScannedCase) -> Iterator[Finding]:
    """Yield the findings about a case: first whether it can be diagnosed, then the rest."""
    facts = facts_of(case)
    missing = [finding for scan in facts.scans for finding in _tissues(scan)]
    yield from missing
    if missing:
        return
    yield from _repeat(case)
    yield from findings_of(facts)


def facts_of(case: ScannedCase) -> BreastFacts:
    """Return the facts to check; a planned case has only the scan at rest."""
    loads = [case_load(case, number) for number in range(len(case.loads))]
    scanned = case.deformed if case.is_scanned else []
    scans = [
        Scan(
            load.volume,
            load.force_n,
            unit_axis(load.axis),
            case.above_wall(labels),
            labels,
            case.cut_cm2.get(load.volume),
            case.air.get(load.volume),
        )
        for load, labels in zip(case.loads, scanned, strict=False)
    ]
    young = [KPA.to_inside(value) for value in _values(case.file, "E_fat_kpa")]
    name, softest, stiffest = case.file.scans.reference, *_tissues_at_bounds(case)
    cut, air = case.cut_cm2.get(name), case.air.get(name)
    return BreastFacts(
        rest=Scan(name, 0.0, ALONG_Y, case.reference, cut_cm2=cut, filled=air),
        pressed=list(zip(scans, loads, strict=False)),
        loads=loads,
        least_nu=case.file.nu,
        E_mpa=(min(young), max(young)),
        align_key="scans.align",
        aligned=case.file.scans.align is not None,
        swelling=SWELLING,
        rigid_is_refused=False,
        softest=softest,
        stiffest=stiffest,
    )


def _tissues_at_bounds(case: ScannedCase) -> tuple[Tissues, Tissues]:
    """Return the constants of the tissues at the lower and at the upper bounds."""
    build, free = case.problem(0, Frame()), case.free
    low = build({constant.name: constant.lower for constant in free}).constants
    high = build({constant.name: constant.upper for constant in free}).constants
    return low, {} if case.file.wall.held else high


def _values(file: CaseFile, name: str) -> tuple[float, ...]:
    value = file.constants[name]
    if isinstance(value, str):
        return ()
    return value if isinstance(value, tuple) else (value,)


def _tissues(scan: Scan) -> Iterator[Finding]:
    for tissue in (Tissue.FAT, Tissue.GLANDULAR):
        if not (scan.labels.values == tissue).any():
            yield Finding(
                "impossible",
                f"{scan.file} has no voxel labelled {tissue.name.lower()} ({int(tissue)}) above "
                "the chest wall, expected both fat (1) and glandular tissue (2). Segment them, or "
                "write an origin into its header that puts the chest wall at the z of the case.",
            )


def _repeat(case: ScannedCase) -> Iterator[Finding]:
    if case.repeat is None:
        return
    here = case.reference.values == Tissue.GLANDULAR
    there = resample_labels(case.repeat, case.reference).values == Tissue.GLANDULAR
    overlap = jaccard(int((here & there).sum()), int(here.sum()), int(there.sum()))
    if overlap < SAME_GLAND:
        yield Finding(
            "implausible",
            f"The glandular tissue in {case.file.scans.reference_repeat} overlaps that of the "
            f"reference scan with a Jaccard of {overlap:.2f}; two segmentations of the same scan "
            f"reach {SAME_GLAND} or more. Segment the reference scan again, or omit "
            "scans.reference_repeat.",
        )


# Names of the volumes in the content of a case; loaded scans are numbered.
REFERENCE, REPEAT, LOADED = "reference", "repeat", "loaded_"


class PlannedCaseSource:
    """A case before its loaded scans; see `diagnosis.outcome.diagnosis_source.PlannedSource`.

    Parameters
    ----------
    case : ScannedCase
    """

    kind = "planned case"

    def __init__(self, case: ScannedCase) -> None:
        self.case = case

    @classmethod
    def from_content(cls, content: SourceContent) -> Self:
        """Restore a source from its stored content."""
        volumes = content.volumes
        file = validated(CaseFile, content.record, "The case in the store")
        loaded = [volumes[name] for name in sorted(volumes, key=_number) if name.startswith(LOADED)]
        return cls(ScannedCase(file, volumes[REFERENCE], volumes.get(REPEAT), loaded))

    @property
    def content(self) -> SourceContent:
        """The settings and the scans."""
        case = self.case
        volumes = {REFERENCE: case.reference}
        if case.repeat is not None:
            volumes[REPEAT] = case.repeat
        if case.is_scanned:
            volumes |= {f"{LOADED}{number}": scan for number, scan in enumerate(case.deformed)}
        return SourceContent(self.kind, case.file.record, volumes, {})

    def findings(self) -> Iterator[Finding]:
        """See `workers.organs.plausibility_rule.CheckedSource`."""
        yield from case_findings(self.case)

    @property
    def caveats(self) -> tuple[str, ...]:
        """Descriptions of the alignment of the scans."""
        return self.case.motions

    @property
    def acquisition(self) -> Acquisition:
        """The acquisition, without the loaded scans."""
        return acquisition_of(self.case)


class ScannedCaseSource(PlannedCaseSource, SegmentedScans):
    """A case with its loaded scans; see `workers.diagnosis.outcome.diagnosis_source.Source`."""

    kind = "scanned case"

    @property
    def name(self) -> str:
        """Name of the case."""
        return self.case.file.name

    @property
    def scans(self) -> Sequence[str]:
        """Names of the loaded scans."""
        return self.case.names

    @property
    def effects(self) -> Sequence[Effect]:
        """Effects that the model of a breast may lack."""
        return self.case.file.model.laws.suspects

    @property
    def pressed(self) -> Mapping[str, Pressed]:
        """Compression in each loaded scan, by name."""
        return {load.name: Pressed(load.axis, load.force_n) for load in self.case.loads}

    @property
    def loaded(self) -> Sequence[Volume]:
        """The loaded scans."""
        return self.case.deformed

    @property
    def not_simulated(self) -> tuple[tuple[str, str], ...] | None:
        """See `TissueLaws.not_simulated`."""
        return self.case.file.model.laws.not_simulated


def _number(name: str) -> int:
    return int(name.removeprefix(LOADED)) if name.startswith(LOADED) else -1
