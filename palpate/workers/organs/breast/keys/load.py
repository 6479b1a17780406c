"""Keys of the compression."""

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    Field,
    model_validator,
)

from palpate.workers.missing_keys import Pairs
from palpate.workers.spec import (
    Door,
    Finite,
    Positive,
)


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
    PlateDistanceSpec,
    BeforeValidator(_final, json_schema_input_type=Positive | PlateDistanceSpec),
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
    """

    exactly_one: ClassVar[Pairs] = (("force_n", "plate_distance_mm"),)

    force_n: Positive | None = Field(default=None, description="the force on the plates, in N")
    plate_distance_mm: PlateDistance | None = Field(
        default=None,
        description="the distance between the plates, in mm; or {initial: 120, final: 65}, or "
        "their final positions {lower: 10, upper: 75}",
    )
    oblique_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0
    moving: Literal["upper", "both"] = "upper"

    @property
    def text(self) -> str:
        """Return a description of the compression."""
        turned = f", turned by {self.oblique_deg:g} degrees" if self.oblique_deg else ""
        if self.force_n is not None:
            return f"{self.force_n:g} N, from where the body at rest ends{turned}"
        distance = self.plate_distance_mm or PlateDistanceSpec(final=1.0)
        if distance.final is not None:
            return f"{distance.final:g} mm apart{turned}"
        return f"at {distance.lower:g} and {distance.upper:g} mm{turned}"
