"""Segmented scans as the source of a diagnosis, and planned scans as the source of a plan.

Their plausibility is checked from the file of the case and from its scans.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from palpate.storage.values import Tissue
from palpate.workers.body.images.tissue_labels import resample_labels
from palpate.workers.common_keys import validated
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.comparison.similarity_score import jaccard
from palpate.workers.diagnosis.outcome.body_pictures import Displacements, pictures_of_scans
from palpate.workers.diagnosis.outcome.diagnosis_source import SourceContent
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.planned_acquisition import (
    Acquisition,
    finer_model,
    inverse_problem_of,
    prepare_scan,
)
from palpate.workers.diagnosis.problem.prepared_parts import Prepared, ReadPrepared, preparations_of
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.boundary_value_problem import Frame
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.mechanics.fem.loads_and_regions import Pressed
from palpate.workers.mechanics.model_parameters import KPA
from palpate.workers.organs.breast.scan_facts import BreastFacts, Scan, Tissues, unit_axis
from palpate.workers.organs.breast.scan_plausibility import findings_of
from palpate.workers.organs.breast.scanned_case import ScannedCase, acquisition_of, case_load
from palpate.workers.organs.breast.scanned_case_keys import ALONG_Y, CaseFile
from palpate.workers.organs.plausibility_rule import Finding, accept

# Minimum Jaccard coefficient of the glandular tissue in two segmentations of one scan.
SAME_GLAND = 0.5
# Swelling is a cause that a diagnosis can find: 12 % of gland that fills a third of a body.
SWELLING = 0.04


def check_case(case: ScannedCase, *, anyway: bool = False) -> list[Finding]:
    """Reject scans that cannot show one body under these loads.

    Parameters
    ----------
    case : ScannedCase
    anyway : bool
        Accept implausible scans.

    Raises
    ------
    InputError
        If the scans are rejected; the message lists every reason.
    """
    return accept(case_findings(case), f"The case {case.file.name}", anyway=anyway)


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


class ScannedCaseSource:
    """A case with its loaded scans; see `workers.diagnosis.outcome.diagnosis_source.Source`.

    Parameters
    ----------
    case : ScannedCase
    """

    kind = "scanned case"

    def __init__(self, case: ScannedCase) -> None:
        self.case = case

    @classmethod
    def from_content(cls, content: SourceContent) -> "ScannedCaseSource":
        """Restore a source from its stored content."""
        return cls(_case_from(content))

    @property
    def content(self) -> SourceContent:
        """The settings and all scans."""
        return _content(self.kind, self.case)

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
    def segmentation_noise(self) -> SegmentationNoise:
        """Noise of the segmentations."""
        return self.case.noise

    def check(self) -> None:
        """Reject scans that cannot show one body under these loads."""
        check_case(self.case)

    def findings(self) -> Iterator[Finding]:
        """See `workers.organs.plausibility_rule.CheckedSource`."""
        yield from case_findings(self.case)

    @property
    def caveats(self) -> tuple[str, ...]:
        """Descriptions of the alignment of the scans."""
        return self.case.motions

    @property
    def preparations(self) -> Sequence[str]:
        """Names of the preparations: points, body and loaded scans."""
        return preparations_of(len(self.case.deformed))

    def prepare(self, name: str, spacing_mm: float) -> Prepared:
        """Compute one of the preparations."""
        return prepare_scan(self.acquisition, name, spacing_mm, self.case.deformed)

    def inverse_problem(
        self, nodes: int, spacing_mm: float, prepared: ReadPrepared | None = None
    ) -> InverseProblem:
        """Return the comparison of points on the interfaces of the meshed body with the scans."""
        scans = self.case.deformed
        return inverse_problem_of(self.acquisition, nodes, spacing_mm, scans, prepared)

    def finer(self, nodes: int, prepared: ReadPrepared | None = None) -> Model:
        """Return another mesh of the same outline."""
        return finer_model(self.acquisition, nodes, prepared)

    @property
    def acquisition(self) -> Acquisition:
        """The acquisition, without the loaded scans."""
        return acquisition_of(self.case)

    def describe(
        self,
        diagnosis: Diagnosis,
        displacements: Displacements,
        summary: Summary,
        prepared: ReadPrepared,
        each: Each = map,
    ) -> tuple[dict[str, NDArray[Any]], Summary]:
        """Draw bodies, maps and overlaps."""
        case = self.case
        return pictures_of_scans(
            diagnosis,
            self.effects,
            displacements,
            replace(summary, not_simulated=case.file.model.laws.not_simulated),
            case.reference,
            case.deformed,
            prepared,
            each,
        )


class PlannedCaseSource:
    """A case whose loaded scans need not exist; see `diagnosis.outcome.source.PlannedSource`.

    Parameters
    ----------
    case : ScannedCase
        Its body at rest replaces the loaded scans.
    """

    kind = "planned case"

    def __init__(self, case: ScannedCase) -> None:
        self.case = case

    @classmethod
    def from_content(cls, content: SourceContent) -> "PlannedCaseSource":
        """Restore a source from its stored content."""
        return cls(_case_from(content))

    def findings(self) -> Iterator[Finding]:
        """See `workers.organs.plausibility_rule.CheckedSource`."""
        yield from case_findings(self.case.unloaded)

    @property
    def caveats(self) -> tuple[str, ...]:
        """No caveats: the scans do not exist yet."""
        return ()

    @property
    def content(self) -> SourceContent:
        """The settings and the scan at rest."""
        return _content(self.kind, self.case.unloaded)

    @property
    def acquisition(self) -> Acquisition:
        """The body, its loads and its noise."""
        return acquisition_of(self.case)


def _content(kind: str, case: ScannedCase) -> SourceContent:
    volumes = {REFERENCE: case.reference}
    if case.repeat is not None:
        volumes[REPEAT] = case.repeat
    if case.is_scanned:
        volumes |= {f"{LOADED}{number}": scan for number, scan in enumerate(case.deformed)}
    return SourceContent(kind, case.file.record, volumes, {})


def _case_from(content: SourceContent) -> ScannedCase:
    file, volumes = validated(CaseFile, content.record, "The case in the store"), content.volumes
    loaded = [volumes[name] for name in sorted(volumes, key=_number) if name.startswith(LOADED)]
    return ScannedCase(file, volumes[REFERENCE], volumes.get(REPEAT), loaded)


def _number(name: str) -> int:
    return int(name.removeprefix(LOADED)) if name.startswith(LOADED) else -1
