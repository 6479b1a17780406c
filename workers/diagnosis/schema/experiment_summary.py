"""The part of a diagnosis that only bench experiments have: points, forces, states to come."""

from collections.abc import Mapping
from dataclasses import dataclass

from palpate.storage.values import Triple


@dataclass(frozen=True, slots=True)
class MarkerResidual:
    """What a point of a specimen has done, along x, y and z of the body.

    `before_mm` and `after_mm` are what the models leave of it.
    """

    name: str
    displacement_mm: Triple
    before_mm: Triple
    after_mm: Triple | None


@dataclass(frozen=True, slots=True)
class Reaction:
    """The force on a region along an axis, and how surely it is known."""

    region: str
    axis: str
    force_n: float
    sd_n: float

    @property
    def place(self) -> str:
        """Where it acts, as a reader is told."""
        return f"{self.region} along {self.axis}"


@dataclass(frozen=True, slots=True)
class ReactionResidual(Reaction):
    """A force as it was read, with what the models leave of it."""

    before_n: float
    after_n: float | None


@dataclass(frozen=True, slots=True)
class MarkerState:
    """All points of one state; `repeats_mm` is how far two recordings differ, None for one."""

    state: str
    repeats_mm: float | None
    points: tuple[MarkerResidual, ...]
    reactions: tuple[ReactionResidual, ...] = ()

    def __repr__(self) -> str:
        return f"<State {self.state}: {len(self.points)} points measured>"


@dataclass(frozen=True, slots=True)
class ConfoundedEffect:
    """The constants in kPa, ``without`` and ``with`` an effect of that size that they hide."""

    name: str
    size: Mapping[str, float]
    constants_kpa: Mapping[str, Mapping[str, float]]

    def __repr__(self) -> str:
        return f"<Confounded effect {self.name}: {', '.join(self.constants_kpa)}"[:498] + ">"


@dataclass(frozen=True, slots=True)
class PredictedPoint:
    """Where a point is expected to go, along x, y and z of the body, and how surely."""

    name: str
    displacement_mm: Triple
    sd_mm: Triple


@dataclass(frozen=True, slots=True)
class PredictedState:
    """All points of a state that was not measured, and the forces that move it."""

    state: str
    points: tuple[PredictedPoint, ...]
    reactions: tuple[Reaction, ...] = ()

    def __repr__(self) -> str:
        return f"<State {self.state}: {len(self.points)} points predicted>"
