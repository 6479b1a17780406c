"""Sources of an inverse problem: a case, a study or an experiment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray

from palpate.storage.values import Volume
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.outcome.body_pictures import Displacements
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.planned_acquisition import Acquisition
from palpate.workers.diagnosis.problem.prepared_parts import Prepared, ReadPrepared
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.mechanics.fem.loads_and_regions import Pressed


@dataclass(frozen=True, eq=False)
class SourceContent:
    """The content of a source as stored, from which the source can be recreated.

    Parameters
    ----------
    kind : str
        Name of the class that recreates the source; see `workers.tasks.diagnosis_sources`.
    record : mapping
        The text and numbers of its files, as JSON.
    volumes : mapping of str to Volume
        Scans of the source.
    arrays : mapping of str to ndarray
        Other measurements of the source.
    """

    kind: str
    record: Mapping[str, Any]
    volumes: Mapping[str, Volume]
    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class FinishedStudy:
    """Specification and stored results of a finished study.

    Parameters
    ----------
    name : str
    case, target, score : mapping
        Sections of the study file.
    parameters : mapping of str to (float, float)
        Searched intervals, in external names and units.
    best : mapping of str to float
        Searched parameters of the best candidate, in the same units; empty if there is none.
    reference, deformed
        The body at rest and the observed deformed body, in the representation of the organ.
    caveats : tuple of str
        Caveats shown at the top of every result of the study.
    """

    name: str
    case: Mapping[str, Any]
    target: Mapping[str, Any]
    score: Mapping[str, Any]
    parameters: Mapping[str, Any]
    best: Mapping[str, float]
    reference: Any
    deformed: Any
    caveats: tuple[str, ...] = ()


class HasContent(Protocol):
    """An object whose content can be stored."""

    @property
    def content(self) -> SourceContent:
        """The complete content."""


class PlannedSource(HasContent, Protocol):
    """A source for which loaded scans can be planned before they are made."""

    @property
    def acquisition(self) -> Acquisition:
        """The information available before the loaded scans."""


@runtime_checkable
class Checkable(Protocol):
    """A source that can check its data, other than by findings."""

    def check(self) -> None:
        """Check, before anything is fitted, that the data can be one body in several states.

        Raises
        ------
        InputError
            If they cannot; names the value found, the value expected and what to change.
        """


@runtime_checkable
class PressedSource(Protocol):
    """A source of segmented scans of a body between plates."""

    @property
    def pressed(self) -> Mapping[str, Pressed]:
        """Compression by the plates in each loaded scan, by name."""

    @property
    def segmentation_noise(self) -> SegmentationNoise:
        """Errors in the segmentations."""


@runtime_checkable
class PreparedSource(Protocol):
    """A source with parts that can be prepared separately, before anything is fitted."""

    @property
    def preparations(self) -> Sequence[str]:
        """Names of the parts that `prepare` can make, the slowest first.

        See `workers.diagnosis.problem.prepared_parts`.
        """

    def prepare(self, name: str, spacing_mm: float) -> Prepared:
        """Prepare one part, for points spaced `spacing_mm` apart."""


class Source(HasContent, Protocol):
    """An imaged or measured object, with a model of it."""

    @property
    def name(self) -> str:
        """The name given by the user."""

    @property
    def scans(self) -> Sequence[str]:
        """Names of the loaded states, in order."""

    @property
    def effects(self) -> Sequence[Effect]:
        """Catalogue of effects that may be missing from the model."""

    def inverse_problem(
        self, nodes: int, spacing_mm: float, prepared: ReadPrepared | None = None
    ) -> InverseProblem:
        """Mesh the body with `nodes` nodes and place points `spacing_mm` apart on it.

        Parameters
        ----------
        nodes : int
        spacing_mm : float
        prepared : callable, optional
            Returns a part made by `PreparedSource.prepare`; by default, the part is made here.

        Raises
        ------
        InputError
            If there is no body to mesh or no data to compare.
        """

    def finer(self, nodes: int, prepared: ReadPrepared | None = None) -> Model | None:
        """Return a finer mesh to estimate the mesh error; None if that error is known."""

    def describe(
        self,
        diagnosis: Diagnosis,
        displacements: Displacements,
        summary: Summary,
        prepared: ReadPrepared,
        each: Each = map,
    ) -> tuple[dict[str, NDArray[Any]], Summary]:
        """Return the arrays for the report's pictures, and the summary with added rows.

        Parameters
        ----------
        diagnosis : Diagnosis
        displacements : mapping of str to sequence of ndarray
            See `workers.diagnosis.outcome.body_pictures`.
        summary : Summary
            Summary of the diagnosis, without these rows.
        prepared : callable
            Returns a part made by `PreparedSource.prepare`.
        each : callable
            Applies a function to every item; see `workers.kernels_and_threads`.
        """
