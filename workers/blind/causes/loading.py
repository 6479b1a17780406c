"""Forces that are not the nominal ones."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from workers.blind.causes.base import Rng, direction, log_uniform, sign
from workers.blind.scene import Anatomy, Scene


@dataclass(frozen=True, slots=True)
class PlateForce:
    """A sensor that is off: nothing tells it from softer or stiffer tissue."""

    kind: ClassVar[str] = "plate_force"
    effect: ClassVar[str | None] = "plate_force"
    family: ClassVar[str | None] = "loading"
    factor: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """From 0.7 to 1.3."""
        return cls(math.exp(sign(rng) * log_uniform(rng, 0.04, 0.35)))

    def put(self, scene: Scene) -> Scene:
        return replace(scene, force_factor=scene.force_factor * self.factor)


@dataclass(frozen=True, slots=True)
class Gravity:
    """Another posture in the loaded scans."""

    kind: ClassVar[str] = "gravity"
    effect: ClassVar[str | None] = "gravity_change"
    family: ClassVar[str | None] = "loading"
    x_g: float
    y_g: float
    z_g: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        size = log_uniform(rng, 0.03, 1.0)
        x, y, z = direction(rng)
        return cls(size * x, size * y, size * z)

    def put(self, scene: Scene) -> Scene:
        return replace(scene, gravity_g=(self.x_g, self.y_g, self.z_g))
