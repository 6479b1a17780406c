"""Keys of the undeformed body: a phantom or an image."""

from typing import Annotated, Any, ClassVar, Self

from pydantic import (
    BeforeValidator,
    Field,
    model_validator,
)

from palpate.storage.errors import InputError
from palpate.workers.body.images.label_map import label_map
from palpate.workers.body.images.orient import parse_axes
from palpate.workers.body.phantom.settings import BreastPhantom
from palpate.workers.missing_keys import Pairs
from palpate.workers.spec import (
    Door,
    Positive,
    checked,
)


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

    See `workers.body.phantom.settings.BreastPhantom` for what each setting does.

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
    """Keys for reading an image; see `workers.body.images.read.read_volume`.

    Parameters
    ----------
    labels
        Tissue of each label: ``{1: fat, 2: glandular}``, by number or by segment name; or a file
        of label names. Default: the names in the image.
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
