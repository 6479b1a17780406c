"""Keys of a study of a breast: its case, target and score."""

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, ClassVar, Literal, Self

from pydantic import (
    Field,
    StringConstraints,
    model_validator,
)

from palpate.storage.values import Tissue
from palpate.workers.body.images.labels import tissue_named
from palpate.workers.mechanics.parameters import BREAST, Vocabulary
from palpate.workers.missing_keys import Pairs
from palpate.workers.organs.breast import default_physics as physics
from palpate.workers.organs.breast.effects import BREAST_MODEL
from palpate.workers.organs.breast.keys.images import ImageSpec, ReferenceSpec
from palpate.workers.organs.breast.keys.load import LoadSpec
from palpate.workers.organs.breast.keys.model import MeshSpec, ModelSpec
from palpate.workers.organs.breast.laws import LAW_TISSUES, shape_constants
from palpate.workers.organs.breast.physics_words import law_text, wall_text
from palpate.workers.spec import (
    CaseSpec,
    Identifiable,
    ScoreSpec,
    TargetSpec,
    checked,
)
from palpate.workers.units import FORCE_UNITS, KPA

TissueName = Annotated[
    str, StringConstraints(to_lower=True, strip_whitespace=True), checked(tissue_named)
]


def _known_constants(given: Mapping[str, float]) -> None:
    """Reject unknown names and values; the case checks that the law of a shape constant is used."""
    BREAST_MODEL.extended_by(shape_constants(given)).from_door(given)


DoorConstants = Annotated[dict[str, float], checked(_known_constants)]


_WALL = wall_text(physics.WALL_HELD, physics.WALL_SPRING_KPA_PER_MM, physics.WALL_SPRING_KPA_PER_MM)


class BreastCase(CaseSpec):
    """A breast, its mesh, its model and its load.

    Parameters
    ----------
    organ
        Name of the organ.
    mesh
        Resolution of the mesh. Default: 20,000 nodes.
    model
        Law of the tissue, and the skin.
    load
        Compression. Default: a force of 100 N; a study of images must give it.
    """

    law_tissues: ClassVar[tuple[str, ...]] = LAW_TISSUES

    organ: Literal["breast"] = "breast"
    reference: ReferenceSpec
    mesh: MeshSpec = MeshSpec(nodes=20_000)
    model: ModelSpec = ModelSpec()
    load: LoadSpec = LoadSpec(force_n=100.0)
    constants: DoorConstants = Field(default_factory=dict, description="a value that is held")

    @property
    def parameters(self) -> Vocabulary:
        """See `CaseSpec.parameters`."""
        return self.vocabulary.without(n for n in self.vocabulary.names if self._unused(n))

    @property
    def vocabulary(self) -> Vocabulary:
        """See `CaseSpec.vocabulary`."""
        return BREAST_MODEL.extended_by(self.model.law.constants)

    @property
    def plugged_modules(self) -> Sequence[str]:
        """See `CaseSpec.plugged_modules`: the laws."""
        return self.model.law.modules

    @model_validator(mode="after")
    def _constants_of_its_laws(self) -> Self:
        for name in self.constants:
            if reason := self.model.law.reason_against(name):
                raise ValueError(f"constants: {name} is not used: {reason}")
        return self

    @property
    def mesh_nodes(self) -> int | None:
        """See `CaseSpec.mesh_nodes`."""
        return self.mesh.nodes

    def understood(self, searched: Collection[str]) -> list[tuple[str, str]]:
        """See `CaseSpec.understood`."""
        model, skin = self.model, self.model.skin
        rows = [
            (
                "law",
                law_text(
                    model.fibres, model.fibre_invariant, physics.FIBRE_DIRECTION, model.law.text
                ),
            ),
            ("chest wall", f"where the body begins, {_WALL}"),
            ("skin", "as fat" if skin == "none" else f"{skin}, {model.skin_thickness_mm:g} mm"),
            ("plates", self.load.text),
        ]
        values, stated = self.complete(), self.vocabulary.from_door(self.constants)
        constants = (*BREAST, *model.law.constants)
        known = self.parameters
        held = [p for p in constants if p.name in known and p.name not in searched]
        followed = [p for p in held if p.follows and p.name not in stated]
        texts = [
            f"{p.name} {p.unit.text(values[p.name])}{'' if p.name in stated else ' (default)'}"
            for p in held
            if p not in followed
        ]
        return [*rows, ("held", ", ".join(texts) or "nothing")]

    def complete(self, constants: Mapping[str, float] | None = None) -> dict[str, float]:
        """See `CaseSpec.complete`."""
        vocabulary = self.vocabulary
        return vocabulary.complete(vocabulary.from_door(self.constants), constants or {})

    def identifiable(self, searched: Collection[str]) -> Identifiable:
        """See `CaseSpec.identifiable`.

        If the distance of the plates is prescribed, multiplying all stiffnesses and all forces by
        the same factor changes no deformation, so one of them has to be held.
        """
        if self.load.force_n is not None:
            return "absolute"
        values = self.complete()
        stated = self.vocabulary.from_door(self.constants)
        for p in self.parameters:
            follows = p.follows in searched and p.name not in stated
            if p.unit in FORCE_UNITS and values[p.name] and p.name not in searched and not follows:
                return "absolute"
        return "ratio"

    def common_scale(self, searched: Sequence[str]) -> tuple[str, ...]:
        """See `CaseSpec.common_scale`: a prescribed distance leaves the forces undetermined."""
        vocabulary = self.vocabulary
        scaled = [n for n in searched if vocabulary[n].unit in FORCE_UNITS]
        stiffnesses = all(vocabulary[n].unit == KPA for n in scaled)
        absolute = self.identifiable(searched) == "absolute"
        return () if absolute or not stiffnesses else tuple(scaled)

    def unused_parameter(self, name: str) -> str:
        """See `CaseSpec.unused_parameter`."""
        return self._unused("E_skin" if name == "E_skin_kpa" else name)

    def _unused(self, name: str) -> str:
        if name == "E_skin" and self.model.skin == "none":
            return "the case has no skin: case.model.skin is none"
        return self.model.law.reason_against(name)


class BreastTarget(ImageSpec, TargetSpec):
    """The deformed body to match: simulated with hidden constants, or an image.

    With ``align: rigid`` an image is first moved into the frame of the reference; see
    `workers.organs.breast.plausibility.rigid_motion`.

    Parameters
    ----------
    mesh
        Mesh of a simulated target, such as a finer one. Default: the mesh of the case.
    align
        ``rigid``: an image is first moved into the frame of the reference. Default: it already is
        in that frame.
    """

    exactly_one: ClassVar[Pairs] = (("constants", "volume"),)

    constants: DoorConstants | None = Field(
        default=None, description="the hidden value with which the target is simulated"
    )
    mesh: MeshSpec | None = None
    align: Literal["rigid"] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.constants is not None:
            self._refuse_image_keys("constants")
            if self.align is not None:
                raise ValueError("align is for an image, but constants are given: remove it")
        elif self.mesh is not None:
            raise ValueError("a mesh is for a simulated target, but a volume is given: remove it")
        return self

    @property
    def is_aligned(self) -> bool:
        """See `TargetSpec.is_aligned`."""
        return self.align is not None


class BreastScore(ScoreSpec):
    """Compared tissues, and the voxels between which distances are measured.

    Parameters
    ----------
    labels
        Tissues that are compared.
    surface
        Voxels between which distances are measured: those on the surfaces (``boundary``), or all
        of them (``all``).
    """

    labels: Annotated[tuple[TissueName, ...], Field(min_length=1)] = ("glandular",)
    surface: Literal["boundary", "all"] = "boundary"

    @model_validator(mode="after")
    def _solid_and_once(self) -> Self:
        if "air" in self.labels:
            raise ValueError("labels: air is not a tissue; name the tissues to compare")
        if len(set(self.labels)) != len(self.labels):
            raise ValueError(f"labels: name each tissue once, found {list(self.labels)}")
        return self

    @property
    def parts(self) -> tuple[str, ...]:
        """See `ScoreSpec.parts`."""
        return self.labels

    @property
    def compared(self) -> str:
        """See `ScoreSpec.compared`."""
        return f"{' and '.join(self.labels)} tissue"

    @property
    def extent(self) -> tuple[str, str]:
        """See `ScoreSpec.extent`."""
        return "volume", "surfaces" if self.surface == "boundary" else "voxels"

    @property
    def tissues(self) -> tuple[Tissue, ...]:
        """The tissues named in `labels`."""
        return tuple(tissue_named(name) for name in self.labels)
