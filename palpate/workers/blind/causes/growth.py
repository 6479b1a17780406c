"""Causes that make tissue take up water between the scans."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.blind.causes.base import Rng, log_uniform, triple
from palpate.workers.blind.scene import Anatomy, Scene


@dataclass(frozen=True, slots=True)
class Swelling:
    """Water uptake of all glandular tissue, slightly uneven along x."""

    kind: ClassVar[str] = "swelling"
    effect: ClassVar[str | None] = "growth"
    family: ClassVar[str | None] = "growth"
    volume_fraction: float
    unevenness: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        return cls(log_uniform(rng, 0.01, 0.12), rng.uniform(-0.25, 0.25))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        stretch = (1 + self.volume_fraction) ** (1 / 3) - 1

        def at(points: FloatArray, gland: FloatArray) -> FloatArray:
            s = scene.anatomy.normalised(points)[:, 0]
            return np.asarray(stretch * gland * (1 + self.unevenness * np.sin(0.5 * np.pi * s)))

        return replace(scene, growth=(*scene.growth, at))


@dataclass(frozen=True, slots=True)
class Oedema:
    """Water uptake of all tissue in a ball, including fat."""

    kind: ClassVar[str] = "oedema"
    effect: ClassVar[str | None] = None
    family: ClassVar[str | None] = "growth"
    volume_fraction: float
    centre_mm: Triple
    radius_mm: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        place = triple(rng.uniform(-0.4, 0.4, 3) * anatomy.half_mm + anatomy.centre_mm)
        return cls(log_uniform(rng, 0.05, 0.5), place, rng.uniform(10.0, 20.0))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        centre = np.array(self.centre_mm)
        stretch = (1 + self.volume_fraction) ** (1 / 3) - 1

        def at(points: FloatArray, gland: FloatArray) -> FloatArray:
            far = np.linalg.norm(points - centre, axis=1) / self.radius_mm
            return np.asarray(stretch * np.clip(3 - 3 * far, 0, 1))

        return replace(scene, growth=(*scene.growth, at))
