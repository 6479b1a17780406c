"""Parts of a diagnosis specific to bench experiments: points, forces, predicted states."""

from collections.abc import Mapping
from dataclasses import dataclass

from palpate.storage.values import Triple


@dataclass(frozen=True, slots=True)
class MarkerResidual:
    """Displacement of a point on a specimen, along x, y and z of the body.

    `before_mm` and `after_mm` are the residuals of the models.
    """

    name: str
    displacement_mm: Triple
    before_mm: Triple
    after_mm: Triple | None


@dataclass(frozen=True, slots=True)
class Reaction:
    """The force on a region along an axis, with its standard deviation."""

    region: str
    axis: str
    force_n: float
    sd_n: float

    @property
    def place(self) -> str:
        """The region and direction of the force, in words."""
        return f"{self.region} along {self.axis}"


@dataclass(frozen=True, slots=True)
class ReactionResidual(Reaction):
    """A measured force with the residuals of the models."""

    before_n: float
    after_n: float | None


@dataclass(frozen=True, slots=True)
class MarkerState:
    """All points of one state; `repeats_mm` is the distance between two recordings, if any."""

    state: str
    repeats_mm: float | None
    points: tuple[MarkerResidual, ...]
    reactions: tuple[ReactionResidual, ...] = ()

    def __repr__(self) -> str:
        return f"<State {self.state}: {len(self.points)} points measured>"


@dataclass(frozen=True, slots=True)
class ConfoundedEffect:
    """Constants in kPa fitted ``without`` and ``with`` a hidden effect of the given size."""

    name: str
    size: Mapping[str, float]
    constants_kpa: Mapping[str, Mapping[str, float]]

    def __repr__(self) -> str:
        return f"<Confounded effect {self.name}: {', '.join(self.constants_kpa)}"[:498] + ">"


@dataclass(frozen=True, slots=True)
class PredictedPoint:
    """Predicted displacement of a point along x, y and z of the body, with standard deviations."""

    name: str
    displacement_mm: Triple
    sd_mm: Triple


@dataclass(frozen=True, slots=True)
class PredictedState:
    """All points of an unmeasured state, and the forces on it."""

    state: str
    points: tuple[PredictedPoint, ...]
    reactions: tuple[Reaction, ...] = ()

    def __repr__(self) -> str:
        return f"<State {self.state}: {len(self.points)} points predicted>"
