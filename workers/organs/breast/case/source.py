"""A case of segmented scans as the source of a diagnosis, and of a plan before it is scanned."""

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

# Names of the volumes of a case in its content; loaded scans follow by their number.
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
        """Make it again from what the store holds."""
        return cls(_case_from(content))

    @property
    def content(self) -> SourceContent:
        """What its file says, and all scans."""
        return _content(self.kind, self.case)

    @property
    def name(self) -> str:
        """The name that its file gives."""
        return self.case.file.name

    @property
    def scans(self) -> Sequence[str]:
        """Names of the loaded scans."""
        return self.case.names

    @property
    def effects(self) -> Sequence[Effect]:
        """What may be missing from the model of a breast."""
        return self.case.file.model.laws.suspects

    @property
    def pressed(self) -> Mapping[str, Pressed]:
        """How the plates press it in each loaded scan, by name."""
        return {load.name: Pressed(load.axis, load.force_n) for load in self.case.loads}

    @property
    def segmentation_noise(self) -> SegmentationNoise:
        """What its segmentations err by."""
        return self.case.noise

    def check(self) -> None:
        """Refuse scans that cannot be one body under these loads."""
        check_case(self.case)

    def findings(self) -> Iterator[Finding]:
        """See `workers.organs.study_checks.CheckedSource`."""
        yield from case_findings(self.case)

    @property
    def caveats(self) -> tuple[str, ...]:
        """How its scans were aligned."""
        return self.case.motions

    @property
    def preparations(self) -> Sequence[str]:
        """Points, body and loaded scans."""
        return preparations_of(len(self.case.deformed))

    def prepare(self, name: str, spacing_mm: float) -> Prepared:
        """Make one of them."""
        return prepare_scan(self.acquisition, name, spacing_mm, self.case.deformed)

    def inverse_problem(
        self, nodes: int, spacing_mm: float, prepared: ReadPrepared | None = None
    ) -> InverseProblem:
        """Mesh the body, put points on its interfaces and compare them with the scans."""
        scans = self.case.deformed
        return inverse_problem_of(self.acquisition, nodes, spacing_mm, scans, prepared)

    def finer(self, nodes: int, prepared: ReadPrepared | None = None) -> Model:
        """Return another mesh of the same outline."""
        return finer_model(self.acquisition, nodes, prepared)

    @property
    def acquisition(self) -> Acquisition:
        """What is known without looking at its loaded scans."""
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
        Whose body at rest stands for its loaded scans.
    """

    kind = "planned case"

    def __init__(self, case: ScannedCase) -> None:
        self.case = case

    @classmethod
    def from_content(cls, content: SourceContent) -> "PlannedCaseSource":
        """Make it again from what the store holds."""
        return cls(_case_from(content))

    def findings(self) -> Iterator[Finding]:
        """See `workers.organs.study_checks.CheckedSource`."""
        yield from case_findings(self.case.unloaded)

    @property
    def caveats(self) -> tuple[str, ...]:
        """None: its scans are not made yet."""
        return ()

    @property
    def content(self) -> SourceContent:
        """What its file says, and the scan at rest."""
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
