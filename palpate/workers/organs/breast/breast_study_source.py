"""A study as the source of a diagnosis.

The diagnosis uses the model of the study. The searched parameters are its unknown constants, with
the searched intervals as the plausible ones; a parameter that may be zero or negative has no
logarithm and is held at the value found by the search.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Literal

from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, mesh_whole_body
from palpate.workers.common_keys import validated
from palpate.workers.comparison.observation.isosurface import smooth_outline
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.outcome.body_pictures import Displacements, pictures_of_scans
from palpate.workers.diagnosis.outcome.diagnosis_source import FinishedStudy, SourceContent
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant, InverseProblem, Values
from palpate.workers.diagnosis.problem.planned_acquisition import (
    Acquisition,
    ProblemBuilder,
    finer_model,
    inverse_problem_of,
    prepare_scan,
)
from palpate.workers.diagnosis.problem.prepared_parts import Prepared, ReadPrepared, preparations_of
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.mechanics.fem.loads_and_regions import Pressed
from palpate.workers.mechanics.model_parameters import Bounds, Parameter
from palpate.workers.organs.breast.breast_keys import BreastCase, BreastTarget, MeshSpec
from palpate.workers.organs.breast.breast_problem import (
    extent_of,
    materials_of,
    pressed_by,
    problem_of,
)
from palpate.workers.organs.breast.breast_study_checks import BreastChecks
from palpate.workers.organs.breast.scan_facts import in_air, study_noise
from palpate.workers.organs.plausibility_rule import Finding

# Names of both volumes in the content of a study.
REFERENCE, TARGET = "reference", "target"
# Lower end of the plausible interval of a stiffness or a shape constant that was searched from
# zero, relative to its upper end.
LEAST_PART = 0.02


@dataclass(frozen=True, eq=False)
class StudyPieces:
    """Settings and stored volumes of a study.

    Parameters
    ----------
    name : str
    case : BreastCase
    bounds : mapping of str to (float, float)
        Searched intervals, in internal names and units.
    best : mapping of str to float
        The searched parameters of the best candidate; empty if there is none.
    reference, target : Volume
        `Tissue` labels at rest and under the load.
    target_mesh : MeshSpec or None
        Mesh of a simulated target; None for an image.
    caveats : tuple of str
        Statements shown first in every result of the study.
    align : {"rigid"} or None
        How the target was brought into the frame of the reference.
    """

    name: str
    case: BreastCase
    bounds: Mapping[str, Bounds]
    best: Mapping[str, float]
    reference: Volume
    target: Volume
    target_mesh: MeshSpec | None
    caveats: tuple[str, ...] = ()
    align: Literal["rigid"] | None = None


class StudySource:
    """A breast study as a `workers.diagnosis.outcome.diagnosis_source.Source`.

    Parameters
    ----------
    pieces : StudyPieces
    noise : SegmentationNoise, optional
        Noise of both segmentations. Default: half a voxel over 4 mm for images, and the voxel error
        of an interface for a simulated target.
    """

    kind = "breast study"

    def __init__(self, pieces: StudyPieces, noise: SegmentationNoise | None = None) -> None:
        self.pieces = pieces
        self.noise = noise or self._usual_noise()

    @classmethod
    def from_study(cls, study: FinishedStudy) -> "StudySource":
        """Return a finished study as the source of a diagnosis.

        Raises
        ------
        InputError
            If its case or target is invalid.
        """
        case = validated(BreastCase, study.case, "The study's case")
        target = validated(BreastTarget, study.target, "The study's target")
        pieces = StudyPieces(
            name=study.name,
            case=case,
            bounds=case.parameters.bounds_from_door(study.parameters),
            best=case.parameters.from_door(study.best),
            reference=in_air(study.reference),
            target=in_air(study.deformed),
            target_mesh=None if target.constants is None else target.mesh or case.mesh,
            caveats=study.caveats,
            align=target.align,
        )
        return cls(pieces)

    @classmethod
    def from_content(cls, content: SourceContent) -> "StudySource":
        """Recreate the source from the content in the store."""
        record, volumes = content.record, content.volumes
        mesh = record["target_mesh"]
        return cls(
            StudyPieces(
                name=record["name"],
                case=validated(BreastCase, record["case"], "The study's case"),
                bounds={name: (lower, upper) for name, (lower, upper) in record["bounds"].items()},
                best=record["best"],
                reference=volumes[REFERENCE],
                target=volumes[TARGET],
                target_mesh=None if mesh is None else validated(MeshSpec, mesh, "The target"),
            ),
            SegmentationNoise(**record["noise"]),
        )

    @property
    def content(self) -> SourceContent:
        """Case, intervals and best candidate of the study, and both volumes."""
        pieces, mesh = self.pieces, self.pieces.target_mesh
        case = pieces.case.model_dump(mode="json")
        # The body is among the volumes; its origin does not matter any more.
        case["reference"] = {"volume": REFERENCE}
        record = {
            "name": pieces.name,
            "case": case,
            "bounds": {name: list(ends) for name, ends in pieces.bounds.items()},
            "best": dict(pieces.best),
            "target_mesh": None if mesh is None else mesh.model_dump(mode="json"),
            "noise": asdict(self.noise),
        }
        volumes = {REFERENCE: pieces.reference, TARGET: pieces.target}
        return SourceContent(self.kind, record, volumes, {})

    @property
    def name(self) -> str:
        """The name of the study."""
        return self.pieces.name

    @property
    def scans(self) -> Sequence[str]:
        """The name of the single load."""
        load = self.pieces.case.load
        if load.force_n is not None:
            return [f"{load.force_n:g} N"]
        distance = load.plate_distance_mm
        known = distance is not None and distance.final is not None
        return [f"{distance.final:g} mm" if distance is not None and known else "plates in place"]

    @property
    def pressed(self) -> Mapping[str, Pressed]:
        """Compression by the plates under the single load."""
        return dict.fromkeys(self.scans, pressed_by(self.pieces.case.load))

    @property
    def segmentation_noise(self) -> SegmentationNoise:
        """Errors of its segmentations."""
        return self.noise

    @property
    def effects(self) -> Sequence[Effect]:
        """The catalogue of the breast without the searched effects."""
        free = {f.name for f in self.free}
        return [e for e in self.pieces.case.model.law.suspects if not e.is_searched(free)]

    @cached_property
    def free(self) -> list[FreeConstant]:
        """The searched parameters that are positive."""
        case, bounds = self.pieces.case, self.pieces.bounds
        shape = case.model.law.constants.names
        found = [_free(case.vocabulary[name], ends, shape) for name, ends in bounds.items()]
        return [f for f in found if f is not None]

    @property
    def start(self) -> Values:
        """The free parameters of the best candidate; empty if there is none."""
        return {f.name: self.pieces.best[f.name] for f in self.free if f.name in self.pieces.best}

    def check(self) -> None:
        """Check that the study has searched a positive constant."""
        if not self.free:
            raise InputError(
                f"The study {self.name} has searched {', '.join(self.pieces.bounds) or 'nothing'}; "
                "a diagnosis needs a positive constant, such as E_fat_kpa, under "
                "search.parameters."
            )

    def findings(self) -> Iterator[Finding]:
        """See `workers.organs.plausibility_rule.CheckedSource`."""
        self.check()
        pieces = self.pieces
        if pieces.target_mesh is None:
            checks = BreastChecks(pieces.bounds)
            target = BreastTarget(volume=TARGET, align=pieces.align)
            yield from checks.of_bodies(pieces.case, target, None, pieces.reference, pieces.target)

    @property
    def caveats(self) -> tuple[str, ...]:
        """The caveats of the study."""
        return self.pieces.caveats

    @property
    def preparations(self) -> Sequence[str]:
        """Names of the preparations for points, body and target."""
        return preparations_of(1)

    def prepare(self, name: str, spacing_mm: float) -> Prepared:
        """Make one preparation."""
        return prepare_scan(self.acquisition, name, spacing_mm, [self.pieces.target])

    def inverse_problem(
        self, nodes: int, spacing_mm: float, prepared: ReadPrepared | None = None
    ) -> InverseProblem:
        """Mesh the body, place points on its interfaces and compare them with the target."""
        target = [self.pieces.target]
        return inverse_problem_of(self.acquisition, nodes, spacing_mm, target, prepared)

    def finer(self, nodes: int, prepared: ReadPrepared | None = None) -> Model:
        """Return another mesh of the body, or the study's mesh if the target shares it."""
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
        pieces = self.pieces
        return pictures_of_scans(
            diagnosis,
            self.effects,
            displacements,
            replace(summary, not_simulated=pieces.case.model.law.not_simulated),
            pieces.reference,
            [pieces.target],
            prepared,
            each,
        )

    @property
    def acquisition(self) -> Acquisition:
        """The acquisition before the target was scanned."""
        return Acquisition(
            name=self.name,
            reference=self.pieces.reference,
            body=self._body,
            mesh=self._mesh,
            noise=self.noise,
            free=self.free,
            loads=list(self.scans),
            problem=self.problem,
            effects=self.effects,
        )

    def problem(self, number: int, frame: Frame) -> ProblemBuilder:
        """Return a builder of the study's problem from values of the free constants."""
        case, imaged = self.pieces.case, self.pieces.target_mesh is None
        oblique = case.load.oblique_deg
        body = extent_of(self.pieces.reference, oblique)
        target = extent_of(self.pieces.target, oblique) if imaged else None
        held = {n: v for n, v in self.pieces.best.items() if n not in {f.name for f in self.free}}

        def build(values: Values) -> Problem:
            constants = case.complete(held | dict(values))
            return problem_of(case.model, case.load, constants, body, target, frame)

        return build

    @property
    def _shares_mesh(self) -> bool:
        """Whether the target was simulated on the mesh of the candidates."""
        return self.pieces.target_mesh == self.pieces.case.mesh

    def _body(self) -> Volume:
        """Return the volume to be meshed, smoothed if its segmentation is rough."""
        body = materials_of(self.pieces.reference, self.pieces.case.model)
        if self._shares_mesh or not self.noise.reference_sd_mm:
            return body
        return smooth_outline(body, self.noise.correlation_mm)

    def _mesh(self, body: Volume, nodes: int) -> Hierarchy:
        """Mesh the body, like the candidates if their mesh was used to simulate the target."""
        if not self._shares_mesh:
            return mesh_whole_body(body, nodes=nodes)
        mesh = self.pieces.case.mesh
        return mesh_whole_body(body, element_size_mm=mesh.element_size_mm, nodes=mesh.nodes)

    def _usual_noise(self) -> SegmentationNoise:
        pieces = self.pieces
        return study_noise(pieces.reference, pieces.target, imaged=pieces.target_mesh is None)


def _free(p: Parameter, bounds: Bounds, shape: Collection[str]) -> FreeConstant | None:
    lower, upper = bounds
    if lower == 0 < upper and (p.name in shape or p.name.startswith(("E_", "eta_"))):
        lower = LEAST_PART * upper
    return FreeConstant(p.name, lower, upper, p.unit) if lower > 0 else None
