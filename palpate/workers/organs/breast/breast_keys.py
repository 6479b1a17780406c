"""Keys of a study of a breast: body, compression, model, case, target and score.

The undeformed body is a phantom or an image. `SPEC` adds the nuisance parameters: scan, load and
law.
"""

from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, BeforeValidator, Field, StringConstraints, model_validator

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.body.images.scan_orientation import parse_axes
from palpate.workers.body.images.tissue_labels import label_map, tissue_named
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.common_keys import (
    CaseSpec,
    Door,
    Finite,
    Identifiable,
    Positive,
    ScoreSpec,
    TargetSpec,
    checked,
)
from palpate.workers.file_keys import Pairs
from palpate.workers.mechanics.model_parameters import BREAST, FORCE_UNITS, KPA, Vocabulary
from palpate.workers.organs.breast import breast_laws as physics
from palpate.workers.organs.breast.breast_effects import BREAST_MODEL, NUISANCES
from palpate.workers.organs.breast.breast_laws import (
    LAW_TISSUES,
    Laws,
    TissueLaws,
    law_text,
    shape_constants,
    wall_text,
)
from palpate.workers.organs.organ_protocol import Nuisance, OrganSpec


def _three(given: Any) -> Any:
    """Repeat a single number along all three axes."""
    return (given, given, given) if isinstance(given, int | float) else given


SpacingMm = Annotated[
    tuple[Positive, Positive, Positive],
    BeforeValidator(_three, json_schema_input_type=Positive | tuple[Positive, Positive, Positive]),
]


Axes = Annotated[str, checked(parse_axes)]


Labels = Annotated[dict[int | str, str] | str | None, BeforeValidator(label_map)]
"""Tissues by label number or name, or a file that names the labels."""


class PhantomSpec(Door):
    """A generated breast: a preset with changed settings, and a seed.

    See `workers.body.phantom.phantom_settings.BreastPhantom` for what each setting does.

    Parameters
    ----------
    preset
        ``445ml`` or ``250ml``, as in the thesis.
    seed
        Each seed gives a different breast.
    spacing_mm
        Size of a voxel, in mm.
    glandular_fraction
        Glandular share of the volume inside the skin, 0.07 to 0.35.
    lower_mm
        Extent below the nipple, along x, in mm.
    upper_mm
        Extent above the nipple, along x, in mm.
    half_width_mm
        Half the width along y, the direction of compression, in mm.
    depth_mm
        Depth from the chest wall to the nipple, along z, in mm.
    skin_mm
        Thickness of the skin, in mm.
    ligament_mm
        Thickness of the ligaments between compartments, in mm.
    compartments
        Number of compartments of glandular tissue.
    """

    preset: str = "445ml"
    seed: Annotated[int, Field(ge=0)] = 1
    spacing_mm: float | None = None
    glandular_fraction: float | None = None
    lower_mm: float | None = None
    upper_mm: float | None = None
    half_width_mm: float | None = None
    depth_mm: float | None = None
    skin_mm: float | None = None
    ligament_mm: float | None = None
    compartments: int | None = None

    @model_validator(mode="after")
    def _possible(self) -> Self:
        try:
            _ = self.settings
        except InputError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def settings(self) -> BreastPhantom:
        """Settings of the generator."""
        changes = self.model_dump(exclude={"preset", "seed"}, exclude_none=True)
        return BreastPhantom.preset(self.preset, **changes)


class ImageSpec(Door):
    """Keys for reading an image; see `workers.body.images.image_formats.read_volume_file`.

    Parameters
    ----------
    labels
        Tissue of each label: ``{1: fat, 2: glandular}``, by number or by segment name; or a file
        of label names. Default: the names in the image; required if it has none.
    spacing_mm
        Size of a voxel along x, y and z, in mm, for formats that do not state it.
    axes
        Axes of the image in the frame of the body: ``-x,y,-z``, or anatomical directions such as
        ``L S A``. Default: the same axes.
    """

    volume: str | None = Field(
        default=None, description="the segmented image: a file, a folder or a name in the store"
    )
    labels: Labels = None
    spacing_mm: SpacingMm | None = None
    axes: Axes | None = None

    @property
    def labels_text(self) -> str:
        """Return the meaning of the labels in words."""
        named = self.labels
        if isinstance(named, Mapping):
            meaning = ", ".join(f"{label} {tissue}" for label, tissue in named.items())
        else:
            meaning = f"by the names in {'the file' if named is None else Path(named).name}"
        return f"{Path(str(self.volume)).name}: {meaning}"

    def _refuse_image_keys(self, instead: str) -> None:
        given = [k for k in ("labels", "spacing_mm", "axes") if getattr(self, k) is not None]
        if given:
            raise ValueError(
                f"{', '.join(given)} can only be used with an image, but {instead} is given: "
                "remove them, or give a volume"
            )


class ReferenceSpec(ImageSpec):
    """The undeformed body: a phantom, an image file or folder, or a stored volume."""

    exactly_one: ClassVar[Pairs] = (("phantom", "volume"),)

    phantom: PhantomSpec | None = Field(default=None, description="a generated breast")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.phantom is not None:
            self._refuse_image_keys("a phantom")
        return self


def _ascending(record: BaseModel, low: str, high: str, why: str) -> None:
    below, above = getattr(record, low), getattr(record, high)
    if below is not None and above is not None and not below < above:
        raise ValueError(f"{low} ({below:g}) must be less than {high} ({above:g}): {why}")


class PlateDistanceSpec(Door):
    """Final distance of the plates, or their final positions along y.

    Parameters
    ----------
    initial
        Distance between the plates before compression, in mm, if known.
    final
        Distance between the plates under compression, in mm.
    lower
        Final position of the lower plate along y, in mm.
    upper
        Final position of the upper plate along y, in mm.
    """

    initial: Positive | None = None
    final: Positive | None = None
    lower: Finite | None = None
    upper: Finite | None = None

    @model_validator(mode="after")
    def _distance_or_positions(self) -> Self:
        distance = self.final is not None
        positions = self.lower is not None and self.upper is not None
        mixed = distance and (self.lower is not None or self.upper is not None)
        if mixed or not (distance or positions) or (positions and self.initial is not None):
            raise ValueError(
                "give {final: 65} (and initial, if known), or the positions along y "
                "{lower: 10, upper: 75}"
            )
        _ascending(self, "final", "initial", "the plates must come closer")
        _ascending(self, "lower", "upper", "the upper plate is at the higher y")
        return self


def _final(given: Any) -> Any:
    """Convert a single number to the final distance."""
    number = isinstance(given, int | float) and not isinstance(given, bool)
    return {"final": given} if number else given


PlateDistance = Annotated[
    PlateDistanceSpec, BeforeValidator(_final, json_schema_input_type=Positive | PlateDistanceSpec)
]


class LoadSpec(Door):
    """Compression: a force on the plates, or their final distance.

    Parameters
    ----------
    oblique_deg
        Angle of the compression about z, from y towards -x, in degrees: 0 is cranio-caudal,
        45 mediolateral oblique.
    moving
        The plates that move: the upper one, or both.
    fixed_plate_holds_x
        Hold the skin that touches the fixed lower plate before compression along x, as the thesis
        does (4.5.4). By default it slides.
    """

    exactly_one: ClassVar[Pairs] = (("force_n", "plate_distance_mm"),)
    later_keys: ClassVar[tuple[str, ...]] = ("fixed_plate_holds_x",)

    force_n: Positive | None = Field(default=None, description="the force on the plates, in N")
    plate_distance_mm: PlateDistance | None = Field(
        default=None,
        description="the distance between the plates, in mm; or {initial: 120, final: 65}, or "
        "their final positions {lower: 10, upper: 75}",
    )
    oblique_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0
    moving: Literal["upper", "both"] = "upper"
    fixed_plate_holds_x: bool = False

    @model_validator(mode="after")
    def _plate_can_hold(self) -> Self:
        if self.fixed_plate_holds_x and (self.moving == "both" or self.oblique_deg):
            oblique = f"oblique_deg: {self.oblique_deg:g}"
            stated = "moving: both" if self.moving == "both" else oblique
            raise ValueError(
                f"fixed_plate_holds_x needs a plate that is fixed and normal to y, but {stated} is "
                "given: remove one of the two"
            )
        return self

    @property
    def text(self) -> str:
        """Return a description of the compression."""
        held = "; the fixed one holds skin that it touches at rest along x"
        return self._text + held if self.fixed_plate_holds_x else self._text

    @property
    def _text(self) -> str:
        turned = f", turned by {self.oblique_deg:g} degrees" if self.oblique_deg else ""
        if self.force_n is not None:
            return f"{self.force_n:g} N, from where the body at rest ends{turned}"
        distance = self.plate_distance_mm or PlateDistanceSpec(final=1.0)
        if distance.final is not None:
            return f"{distance.final:g} mm apart{turned}"
        return f"at {distance.lower:g} and {distance.upper:g} mm{turned}"


class MeshSpec(Door):
    """Resolution of the mesh: the number of nodes, or the size of the elements.

    Parameters
    ----------
    nodes
        Approximate number of nodes.
    element_size_mm
        Edge length of the elements, in mm.
    """

    exactly_one: ClassVar[Pairs] = (("nodes", "element_size_mm"),)

    nodes: Annotated[int, Field(ge=100, le=5_000_000)] | None = None
    element_size_mm: Positive | None = None


class ModelSpec(Door):
    """Model of the tissue.

    Parameters
    ----------
    skin
        ``none`` (skin counts as fat), ``membrane`` (without bending stiffness) or ``layer`` (solid
        elements; needs a fine mesh).
    skin_thickness_mm
        Thickness of the skin, in mm.
    fibres
        ``tension-only``, or ``literal``: the published formula, also in compression.
    fibre_invariant
        ``I4``, or ``isochoric``: the stretch without the volume change.
    law : str or mapping
        Law of the tissue without its fibres, such as yeoh: one for all tissues, or
        {fat: yeoh, glandular: neo-hookean}. Its shape constants, such as yeoh_c2_fat, can be held
        or searched; `palpate parameters --law yeoh` lists them.
    """

    later_keys: ClassVar[tuple[str, ...]] = ("law",)

    skin: physics.Skin = physics.SKIN
    skin_thickness_mm: Positive = physics.SKIN_THICKNESS_MM
    fibres: physics.Fibres = physics.FIBRES
    fibre_invariant: physics.FibreInvariant = physics.FIBRE_INVARIANT
    law: Laws = TissueLaws()


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

    @cached_property
    def parameters(self) -> Vocabulary:
        """See `CaseSpec.parameters`."""
        return self.vocabulary.without(n for n in self.vocabulary.names if self._unused(n))

    @cached_property
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
        if self.reference.phantom is None:
            rows.append(("labels at rest", self.reference.labels_text))
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
    `workers.organs.breast.scan_alignment`.

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

    @property
    def understood(self) -> list[tuple[str, str]]:
        """See `TargetSpec.understood`: the labels."""
        return [("labels under load", self.labels_text)] if self.is_image else []


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


def nuisances(case: BreastCase, imaged: bool) -> tuple[Nuisance, ...]:
    """Return the nuisance parameters of a case that its laws do not replace; see `OrganSpec`."""
    present = {"model"}
    if imaged:
        present |= {"image"} if case.load.force_n is None else {"image", "force"}
    found = (n for one in NUISANCES if one.of in present for n in one.parameters)
    return tuple(n for n in found if not case.unused_parameter(n.name))


SPEC = OrganSpec(BreastCase, BreastTarget, BreastScore, BREAST_MODEL, nuisances)
