"""Segmented scans of a body at rest and under load, as a source of a diagnosis."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from palpate.storage.values import Volume
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.outcome.body_pictures import Displacements, pictures_of_scans
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
from palpate.workers.mechanics.fem.discretisation import Model


class SegmentedScans(ABC):
    """The part of a `Source` that follows from an acquisition and its loaded scans."""

    @property
    @abstractmethod
    def acquisition(self) -> Acquisition:
        """The acquisition, without the loaded scans."""

    @property
    @abstractmethod
    def loaded(self) -> Sequence[Volume]:
        """`Tissue` labels under each load, in order."""

    @property
    @abstractmethod
    def not_simulated(self) -> tuple[tuple[str, str], ...] | None:
        """See `Summary.not_simulated`."""

    @property
    def segmentation_noise(self) -> SegmentationNoise:
        """Errors in the segmentations."""
        return self.acquisition.noise

    @property
    def preparations(self) -> Sequence[str]:
        """Names of the preparations: points, body and loaded scans."""
        return preparations_of(len(self.loaded))

    def prepare(self, name: str, spacing_mm: float) -> Prepared:
        """Make one preparation."""
        return prepare_scan(self.acquisition, name, spacing_mm, self.loaded)

    def inverse_problem(
        self, nodes: int, spacing_mm: float, prepared: ReadPrepared | None = None
    ) -> InverseProblem:
        """Mesh the body, place points on its interfaces and compare them with the scans."""
        return inverse_problem_of(self.acquisition, nodes, spacing_mm, self.loaded, prepared)

    def finer(self, nodes: int, prepared: ReadPrepared | None = None) -> Model:
        """Return another mesh of the body."""
        return finer_model(self.acquisition, nodes, prepared)

    def describe(
        self,
        diagnosis: Diagnosis,
        displacements: Displacements,
        summary: Summary,
        prepared: ReadPrepared,
        each: Each = map,
    ) -> tuple[dict[str, NDArray[Any]], Summary]:
        """Return the pictures of bodies, maps and overlaps, and the summary with their rows."""
        acquisition = self.acquisition
        return pictures_of_scans(
            diagnosis,
            acquisition.effects,
            displacements,
            replace(summary, not_simulated=self.not_simulated),
            acquisition.reference,
            self.loaded,
            prepared,
            each,
        )
