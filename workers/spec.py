"""What may be asked: the case, the target and the score of a study, checked at the door.

Every key carries its unit. An unknown key is refused with the nearest known one;
`explain` turns what pydantic found into a text for the user, and `validated`
raises it as an `InputError`.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    model_validator,
)

from storage.errors import InputError
from storage.values import Tissue
from workers.effects.catalogue import BREAST_MODEL
from workers.images.labels import tissue_named
from workers.images.orient import parse_axes
from workers.parameters import Bounds, Vocabulary, unknown_name
from workers.phantom.settings import BreastPhantom


def _checked(check: Callable[[Any], object]) -> AfterValidator:
    """Let what `check` says reach the user together with the place of the key."""

    def validate(given: Any) -> Any:
        try:
            check(given)
        except InputError as error:
            raise ValueError(str(error)) from None
        return given

    return AfterValidator(validate)


def _three(given: Any) -> Any:
    """One number stands for three."""
    return (given, given, given) if isinstance(given, int | float) else given


def _exactly_one(record: BaseModel, first: str, second: str) -> None:
    given = [key for key in (first, second) if getattr(record, key) is not None]
    if len(given) != 1:
        found = "both" if given else "neither"
        raise ValueError(f"give exactly one of {first} and {second}, found {found}")


def _ascending(record: BaseModel, low: str, high: str, why: str) -> None:
    below, above = getattr(record, low), getattr(record, high)
    if below is not None and above is not None and not below < above:
        raise ValueError(f"{low} ({below:g}) must be less than {high} ({above:g}): {why}")


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
SpacingMm = Annotated[tuple[Positive, Positive, Positive], BeforeValidator(_three)]
Axes = Annotated[str, _checked(parse_axes)]
TissueName = Annotated[
    str, StringConstraints(to_lower=True, strip_whitespace=True), _checked(tissue_named)
]
DoorConstants = Annotated[dict[str, float], _checked(BREAST_MODEL.from_door)]
DoorBounds = Annotated[dict[str, Bounds], _checked(BREAST_MODEL.bounds_from_door)]


class Door(BaseModel):
    """A frozen record that takes no unknown key."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys_only(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            unknown = [str(key) for key in data if key not in cls.model_fields]
            if unknown:
                raise ValueError(
                    "; ".join(unknown_name("key", k, cls.model_fields) for k in unknown)
                )
        return data


class PhantomSpec(Door):
    """A generated breast: a preset, some of its settings changed, and a seed.

    The settings are those of `workers.phantom.settings.BreastPhantom`.
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
        """What the generator is asked."""
        changes = self.model_dump(exclude={"preset", "seed"}, exclude_none=True)
        return BreastPhantom.preset(self.preset, **changes)


class ImageSpec(Door):
    """The keys that say how an image is read; see `workers.images.read.read_volume`."""

    volume: str | None = None
    labels: dict[int, TissueName] | None = None
    spacing_mm: SpacingMm | None = None
    axes: Axes | None = None

    def _refuse_image_keys(self, instead: str) -> None:
        given = [k for k in ("labels", "spacing_mm", "axes") if getattr(self, k) is not None]
        if given:
            raise ValueError(
                f"{', '.join(given)} say how an image is read, but {instead} is given: "
                "take them out, or give a volume"
            )


class ReferenceSpec(ImageSpec):
    """The undeformed body: a phantom, or an image file, folder or volume of the store."""

    phantom: PhantomSpec | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        _exactly_one(self, "phantom", "volume")
        if self.phantom is not None:
            self._refuse_image_keys("a phantom")
        return self


class MeshSpec(Door):
    """How fine the tetrahedra are: about so many nodes, or of this size."""

    nodes: Annotated[int, Field(ge=100, le=5_000_000)] | None = None
    element_size_mm: Positive | None = None

    @model_validator(mode="after")
    def _one_measure(self) -> Self:
        _exactly_one(self, "nodes", "element_size_mm")
        return self


class ModelSpec(Door):
    """What the model of the tissue contains."""

    skin: Literal["none", "membrane", "layer"] = "none"
    skin_thickness_mm: Positive = 1.5
    fibres: Literal["tension-only", "literal"] = "tension-only"
    fibre_invariant: Literal["I4", "isochoric"] = "I4"


class PlateDistanceSpec(Door):
    """Where the plates end: at a distance, or at two positions along y."""

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
        _ascending(self, "lower", "upper", "the upper plate lies at the higher y")
        return self


class LoadSpec(Door):
    """What presses: a force on the plates, or where they end.

    ``oblique_deg`` turns the direction of compression about z, from y towards -x: 0 is
    cranio-caudal, 45 mediolateral oblique.
    """

    force_n: Positive | None = None
    plate_distance_mm: PlateDistanceSpec | None = None
    oblique_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0
    moving: Literal["upper", "both"] = "upper"

    @model_validator(mode="after")
    def _one_control(self) -> Self:
        _exactly_one(self, "force_n", "plate_distance_mm")
        return self


class CaseSpec(Door):
    """A body, its mesh, its model and its load.

    ``constants`` are those that are not searched; what is missing there keeps its
    neutral value.
    """

    organ: Literal["breast"] = "breast"
    reference: ReferenceSpec
    mesh: MeshSpec = MeshSpec(nodes=20_000)
    model: ModelSpec = ModelSpec()
    load: LoadSpec = LoadSpec(force_n=100.0)
    constants: DoorConstants = Field(default_factory=dict)

    @property
    def parameters(self) -> Vocabulary:
        """What a study of this case can search or hold."""
        return BREAST_MODEL.without(["E_skin"]) if self.model.skin == "none" else BREAST_MODEL

    def complete(self, constants: Mapping[str, float] | None = None) -> dict[str, float]:
        """Every constant, inside names and units: `constants`, then the case's, then neutral.

        Raises
        ------
        InputError
            If a name in `constants` is unknown or a value not admissible.
        """
        return BREAST_MODEL.complete(BREAST_MODEL.from_door(self.constants), constants or {})


class TargetSpec(ImageSpec):
    """The deformed body to be explained: simulated with hidden constants, or an image."""

    constants: DoorConstants | None = None
    mesh: MeshSpec | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        _exactly_one(self, "constants", "volume")
        if self.constants is not None:
            self._refuse_image_keys("constants")
        elif self.mesh is not None:
            raise ValueError("a mesh is for a simulated target, but a volume is given: take it out")
        return self


class ScoreSpec(Door):
    """Which tissues are compared, and which of their voxels measure the distance."""

    labels: Annotated[tuple[TissueName, ...], Field(min_length=1)] = ("glandular",)
    surface: Literal["boundary", "all"] = "boundary"

    @model_validator(mode="after")
    def _solid_and_once(self) -> Self:
        if "air" in self.labels:
            raise ValueError("labels: air is what is left over; name tissues")
        if len(set(self.labels)) != len(self.labels):
            raise ValueError(f"labels: each tissue once, found {list(self.labels)}")
        return self

    @property
    def tissues(self) -> tuple[Tissue, ...]:
        """The tissues that `labels` name."""
        return tuple(tissue_named(name) for name in self.labels)


Record = TypeVar("Record", bound=BaseModel)


def validated(model: type[Record], data: Any, where: str = "") -> Record:
    """`data` as a checked `model`.

    Parameters
    ----------
    model : type
        A record of this file, or of the study.
    data : mapping
        As read from YAML or JSON.
    where : str, optional
        What the data are, for the message: the name of the file.

    Raises
    ------
    InputError
        Naming every wrong key with what was found and what was expected.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        head = f"{where} does not make sense" if where else "This does not make sense"
        raise InputError(f"{head}:\n{explain(error)}") from error


def explain(error: ValidationError) -> str:
    """What is wrong, one line for each key: its path, what was expected, what was found.

    Examples
    --------
    >>> try:
    ...     LoadSpec.model_validate({"force_n": -3})
    ... except ValidationError as error:
    ...     print(explain(error))
      force_n: Input should be greater than 0, found -3
    """
    return "\n".join(_line(dict(e)) for e in error.errors(include_url=False))


def _line(error: dict[str, Any]) -> str:
    path = ".".join(str(part) for part in error["loc"]) or "the whole"
    if error["type"] == "value_error":
        return f"  {path}: {error['ctx']['error']}"
    if error["type"] == "missing":
        return f"  {path}: this key is missing"
    found = repr(error["input"])
    found = found if len(found) <= 60 else f"{found[:57]}..."
    return f"  {path}: {error['msg']}, found {found}"
