"""A finished study as the source of a diagnosis, apart from what differs between organs.

The diagnosis uses the model of the study. The searched parameters are its unknown constants, with
the searched intervals as the plausible ones.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Generic, Self, TypeVar, cast

from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.common_keys import CaseSpec, validated
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.outcome.diagnosis_source import FinishedStudy, SourceContent
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant
from palpate.workers.mechanics.model_parameters import Bounds
from palpate.workers.organs.organ_protocol import OrganSpec
from palpate.workers.organs.plausibility_rule import Finding, checks_of

# Names of both bodies in the content of a study.
REFERENCE, TARGET = "reference", "target"

Case = TypeVar("Case", bound=CaseSpec)
Body = TypeVar("Body")


@dataclass(frozen=True, eq=False)
class SearchedStudy(Generic[Case, Body]):
    """Settings and bodies of a finished study.

    Parameters
    ----------
    name : str
    case : CaseSpec
    bounds : mapping of str to (float, float)
        Searched intervals, in internal names and units.
    best : mapping of str to float
        Searched parameters of the best candidate; empty if there is none.
    reference, target
        The body at rest and under the load.
    own : mapping
        Further settings on which a diagnosis of this organ depends, as plain values.
    noise : SegmentationNoise, optional
        Segmentation noise of both bodies. Default: the organ's usual noise.
    caveats : tuple of str
        Statements shown first in every result of the study.
    stated : TargetSpec, optional
        The target to be checked; None if the study is restored from the store.
    """

    name: str
    case: Case
    bounds: Mapping[str, Bounds]
    best: Mapping[str, float]
    reference: Body
    target: Body
    own: Mapping[str, Any]
    noise: SegmentationNoise | None = None
    caveats: tuple[str, ...] = ()
    stated: Any = None


class FinishedStudySource(ABC, Generic[Case, Body]):
    """A study as a source: an organ adds its problem, its free constants and its pictures.

    The defaults suit bodies that are volumes.

    Parameters
    ----------
    study : SearchedStudy

    Attributes
    ----------
    kind : str
        The `OrganPlugin.study_kind`.
    spec : OrganSpec
        Keys of the organ's studies.
    needs : str
        What a study must have searched, with an example.
    stored_reference : mapping
        Replaces ``reference`` in the stored case: the body is stored, its origin no longer matters.
    """

    kind: ClassVar[str]
    spec: ClassVar[OrganSpec]
    needs: ClassVar[str]
    stored_reference: ClassVar[Mapping[str, Any]] = {"volume": REFERENCE}

    def __init__(self, study: SearchedStudy[Case, Body]) -> None:
        self.study = study

    @classmethod
    def from_study(cls, study: FinishedStudy) -> Self:
        """Return a finished study as the source of a diagnosis.

        Raises
        ------
        InputError
            If its case or target is invalid.
        """
        case: Any = validated(cls.spec.case, study.case, "The study's case")
        target = validated(cls.spec.target, study.target, "The study's target")
        searched = SearchedStudy[Case, Body](
            name=study.name,
            case=case,
            bounds=case.parameters.bounds_from_door(study.parameters),
            best=case.parameters.from_door(study.best),
            reference=study.reference,
            target=study.deformed,
            own={},
            caveats=study.caveats,
            stated=target,
        )
        return cls(cls.completed(searched, target, study.score))

    @classmethod
    @abstractmethod
    def completed(
        cls, study: SearchedStudy[Case, Body], target: Any, score: Mapping[str, Any]
    ) -> SearchedStudy[Case, Body]:
        """Return a study with its `own` settings, from the sections of its file."""

    @classmethod
    def from_content(cls, content: SourceContent) -> Self:
        """Recreate the source from the content in the store."""
        own = dict(content.record)
        case: Any = validated(cls.spec.case, own.pop("case"), "The study's case")
        reference, target = cls.bodies_of(content)
        return cls(
            SearchedStudy(
                name=own.pop("name"),
                case=case,
                bounds={name: (low, high) for name, (low, high) in own.pop("bounds").items()},
                best=own.pop("best"),
                reference=reference,
                target=target,
                noise=SegmentationNoise(**own.pop("noise")),
                own=own,
            )
        )

    @property
    def content(self) -> SourceContent:
        """Case, intervals and best candidate of the study, and both bodies."""
        study = self.study
        record = {
            "name": study.name,
            "case": study.case.model_dump(mode="json") | {"reference": self.stored_reference},
            "bounds": {name: list(ends) for name, ends in study.bounds.items()},
            "best": dict(study.best),
            "noise": asdict(self.noise),
            **study.own,
        }
        return SourceContent(self.kind, record, *self.stored_bodies)

    @property
    def stored_bodies(self) -> tuple[dict[str, Volume], dict[str, NDArray[Any]]]:
        """Both bodies as volumes and as arrays, by name."""
        return cast(Any, {REFERENCE: self.study.reference, TARGET: self.study.target}), {}

    @classmethod
    def bodies_of(cls, content: SourceContent) -> tuple[Body, Body]:
        """Return both bodies from the result of `stored_bodies`."""
        return cast(Any, (content.volumes[REFERENCE], content.volumes[TARGET]))

    @property
    def name(self) -> str:
        """The name of the study."""
        return self.study.name

    @property
    def caveats(self) -> tuple[str, ...]:
        """The caveats of the study."""
        return self.study.caveats

    @property
    def noise(self) -> SegmentationNoise:
        """Segmentation noise of both bodies."""
        return self.study.noise or self.usual_noise

    @property
    @abstractmethod
    def usual_noise(self) -> SegmentationNoise:
        """Noise of a study that is not from the store."""

    @property
    @abstractmethod
    def free(self) -> Sequence[FreeConstant]:
        """The searched parameters that a diagnosis fits."""

    def findings(self) -> Iterator[Finding]:
        """See `workers.organs.plausibility_rule.CheckedSource`.

        Raises
        ------
        InputError
            If the study has not searched what a diagnosis needs.
        """
        study = self.study
        if not self.free:
            raise InputError(
                f"The study {study.name} has searched {', '.join(study.bounds) or 'nothing'}; "
                f"a diagnosis needs {self.needs} under search.parameters."
            )
        checks = checks_of(study.case.organ, study.bounds)
        if checks is not None and study.stated is not None:
            bodies = study.reference, study.target
            yield from checks.of_bodies(study.case, study.stated, None, *bodies)
