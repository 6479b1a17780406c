"""Segmented scans as the source of a diagnosis, and planned scans as the source of a plan."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from palpate.workers.comparison.observation.noise import SegmentationNoise
from palpate.workers.diagnosis.outcome.pictures.scan_pictures import (
    Displacements,
    pictures_of_scans,
)
from palpate.workers.diagnosis.outcome.source import SourceContent
from palpate.workers.diagnosis.problem.acquisition import (
    Acquisition,
    finer_model,
    inverse_problem_of,
    prepare_scan,
)
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.preparation import Prepared, ReadPrepared, preparations_of
from palpate.workers.diagnosis.schema.summary import Summary
from palpate.workers.diagnosis.verdict.diagnosis import Diagnosis
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.fem.elements.model import Model
from palpate.workers.mechanics.pressed import Pressed
from palpate.workers.organs.breast.case.acquisition import acquisition_of
from palpate.workers.organs.breast.case.checks import case_findings, check_case
from palpate.workers.organs.breast.case.scanned_case import ScannedCase
from palpate.workers.organs.breast.case.spec import CaseFile
from palpate.workers.organs.study_checks import Finding
from palpate.workers.scan_threads import Each
from palpate.workers.spec import validated

# Names of the volumes in the content of a case; loaded scans are numbered.
REFERENCE, REPEAT, LOADED = "reference", "repeat", "loaded_"


class ScannedCaseSource:
    """A case with its loaded scans; see `workers.diagnosis.outcome.source.Source`.

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
        """See `workers.organs.study_checks.CheckedSource`."""
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
        """See `workers.organs.study_checks.CheckedSource`."""
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
