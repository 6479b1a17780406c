"""Causes that make plates curved, not parallel, or too short to reach the chest wall."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from palpate.workers.blind.causes.base import Rng, log_uniform, sign
from palpate.workers.blind.scene import Anatomy, Scene


@dataclass(frozen=True, slots=True)
class Tilt:
    """A tilt of the upper plate relative to the lower one."""

    kind: ClassVar[str] = "tilt"
    effect: ClassVar[str | None] = "plate_tilt"
    family: ClassVar[str | None] = "plate geometry"
    depth_deg: float
    across_deg: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        size, angle = log_uniform(rng, 0.4, 6.0), rng.uniform(0, 2 * math.pi)
        return cls(size * math.cos(angle), size * math.sin(angle))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        return replace(scene, tilt_deg=(self.depth_deg, self.across_deg))


@dataclass(frozen=True, slots=True)
class BentPlate:
    """An upper plate bent as a cosine across the body, away from it or towards it."""

    kind: ClassVar[str] = "bent_plate"
    effect: ClassVar[str | None] = None
    family: ClassVar[str | None] = "plate geometry"
    sag_mm: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        return cls(sign(rng) * log_uniform(rng, 0.7, 5.0))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        return replace(scene, sag_mm=self.sag_mm)


@dataclass(frozen=True, slots=True)
class ShortPlate:
    """Plates that start in front of the chest wall, so that skin behind their edge bulges."""

    kind: ClassVar[str] = "short_plate"
    effect: ClassVar[str | None] = "plate_edge"
    family: ClassVar[str | None] = "plate geometry"
    edge_mm: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        return cls(log_uniform(rng, 2.0, 8.0))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        return replace(scene, plate_edge_mm=self.edge_mm)
