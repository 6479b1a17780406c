"""Causes that change the forces."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from palpate.workers.blind.causes.base import Rng, direction, log_uniform, sign
from palpate.workers.blind.scene import Anatomy, Scene


@dataclass(frozen=True, slots=True)
class PlateForce:
    """A wrong scale of the force sensor, indistinguishable from a change in stiffness."""

    kind: ClassVar[str] = "plate_force"
    effect: ClassVar[str | None] = "plate_force"
    family: ClassVar[str | None] = "loading"
    factor: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a factor from 0.7 to 1.3."""
        return cls(math.exp(sign(rng) * log_uniform(rng, 0.04, 0.35)))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        return replace(scene, force_factor=scene.force_factor * self.factor)


@dataclass(frozen=True, slots=True)
class Gravity:
    """A different direction or magnitude of gravity in the loaded scans, due to another posture."""

    kind: ClassVar[str] = "gravity"
    effect: ClassVar[str | None] = "gravity_change"
    family: ClassVar[str | None] = "loading"
    x_g: float
    y_g: float
    z_g: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        size = log_uniform(rng, 0.03, 1.0)
        x, y, z = direction(rng)
        return cls(size * x, size * y, size * z)

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        return replace(scene, gravity_g=(self.x_g, self.y_g, self.z_g))
