"""Where an inverse problem comes from: a case, a study or an experiment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray

from palpate.storage.values import Volume
from palpate.workers.comparison.observation.noise import SegmentationNoise
from palpate.workers.diagnosis.outcome.pictures.scan_pictures import Displacements
from palpate.workers.diagnosis.problem.acquisition import Acquisition
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.preparation import Prepared, ReadPrepared
from palpate.workers.diagnosis.schema.summary import Summary
from palpate.workers.diagnosis.verdict.diagnosis import Diagnosis
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.fem.elements.model import Model
from palpate.workers.mechanics.pressed import Pressed
from palpate.workers.scan_threads import Each


@dataclass(frozen=True, eq=False)
class SourceContent:
    """All that a source is made of: what enters the store, and from which it is made again.

    Parameters
    ----------
    kind : str
        Which class makes it again; see `workers.tasks.sources`.
    record : mapping
        What JSON holds: the words and numbers of its files.
    volumes : mapping of str to Volume
        Its scans.
    arrays : mapping of str to ndarray
        What else it has measured.
    """

    kind: str
    record: Mapping[str, Any]
    volumes: Mapping[str, Volume]
    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class FinishedStudy:
    """What a study that has run says and has in its store.

    Parameters
    ----------
    name : str
    case, target, score : mapping
        As the study states them.
    parameters : mapping of str to (float, float)
        Searched intervals, names and units of the door.
    best : mapping of str to float
        Searched parameters of the best candidate, the same; empty if there is none.
    reference, deformed
        The body at rest and the one to be explained, as its organ has it.
    caveats : tuple of str
        Statements with which every result of the study begins.
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
    """Something that can enter a store."""

    @property
    def content(self) -> SourceContent:
        """All that it is made of."""


class PlannedSource(HasContent, Protocol):
    """Something that can be planned before it is scanned under load."""

    @property
    def acquisition(self) -> Acquisition:
        """What is known before the loaded scans."""


@runtime_checkable
class Checkable(Protocol):
    """A source that can refuse its data."""

    def check(self) -> None:
        """See `Source.check`."""


@runtime_checkable
class PressedSource(Protocol):
    """A source of segmented scans of a body between plates."""

    @property
    def pressed(self) -> Mapping[str, Pressed]:
        """How the plates press it in each loaded scan, by name."""

    @property
    def segmentation_noise(self) -> SegmentationNoise:
        """What its segmentations err by."""


@runtime_checkable
class PreparedSource(Protocol):
    """A source of which parts can be made apart, before anything is fitted."""

    @property
    def preparations(self) -> Sequence[str]:
        """Names of what `prepare` can make, the longest first.

        See `workers.diagnosis.problem.preparation`.
        """

    def prepare(self, name: str, spacing_mm: float) -> Prepared:
        """Make one of them, for points `spacing_mm` apart."""


class Source(HasContent, Protocol):
    """Something that was imaged or measured, with a model of it."""

    @property
    def name(self) -> str:
        """As its owner calls it."""

    @property
    def scans(self) -> Sequence[str]:
        """Names of the loaded states, in order."""

    @property
    def effects(self) -> Sequence[Effect]:
        """Catalogue of what may be missing from the model."""

    def check(self) -> None:
        """See whether the data can be one body in several states, before anything is fitted.

        Raises
        ------
        InputError
            Saying what was found, what was expected and what to change.
        """

    def inverse_problem(
        self, nodes: int, spacing_mm: float, prepared: ReadPrepared | None = None
    ) -> InverseProblem:
        """Mesh the body with `nodes` and put points `spacing_mm` apart on it.

        Parameters
        ----------
        nodes : int
        spacing_mm : float
        prepared : callable, optional
            Gives what `PreparedSource.prepare` has made; without it, it is made here.

        Raises
        ------
        InputError
            If there is nothing to mesh or nothing to compare.
        """

    def finer(self, nodes: int, prepared: ReadPrepared | None = None) -> Model | None:
        """Return another mesh of the same body, to see what the mesh adds; None if known."""

    def describe(
        self,
        diagnosis: Diagnosis,
        displacements: Displacements,
        summary: Summary,
        prepared: ReadPrepared,
        each: Each = map,
    ) -> tuple[dict[str, NDArray[Any]], Summary]:
        """Return what the report draws of the bodies, and the summary with the source's rows.

        Parameters
        ----------
        diagnosis : Diagnosis
        displacements : mapping of str to sequence of ndarray
            See `workers.diagnosis.outcome.pictures.scan_pictures`.
        summary : Summary
            Of the diagnosis, without these rows.
        prepared : callable
            Gives what `PreparedSource.prepare` has made.
        each : callable
            Calls a function with every item; see `workers.scan_threads`.
        """
