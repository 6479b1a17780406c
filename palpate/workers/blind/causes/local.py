"""Causes that change tissue in one place."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.blind.causes.base import Rng, direction, log_uniform, triple
from palpate.workers.blind.scene import Anatomy, Scene


@dataclass(frozen=True, slots=True)
class Inclusion:
    """An unlabelled ellipsoidal lump with a sharp or gradual boundary."""

    kind: ClassVar[str] = "inclusion"
    effect: ClassVar[str | None] = "inclusion"
    family: ClassVar[str | None] = "local stiffness"
    centre_mm: Triple
    radius_mm: float
    stretch_y: float
    stretch_z: float
    fade: float
    ratio: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        radius = rng.uniform(5.0, 12.0)
        low = (-anatomy.lower_mm, -anatomy.half_width_mm, radius)
        high = (anatomy.upper_mm, anatomy.half_width_mm, anatomy.depth_mm)
        while True:
            centre = rng.uniform(low, high)
            if anatomy.depth_inside(centre[None])[0] > radius + 2:
                break
        y, z = (log_uniform(rng, 0.7, 1.4) for _ in range(2))
        fade = 0.0 if rng.random() < 0.5 else rng.uniform(0.1, 0.4)
        return cls(triple(centre), radius, y, z, fade, log_uniform(rng, 2.0, 10.0))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        centre = np.array(self.centre_mm)
        axes = np.array([1.0, self.stretch_y, self.stretch_z])
        axes *= self.radius_mm / np.cbrt(axes.prod())

        def at(points: FloatArray) -> FloatArray:
            far = np.linalg.norm((points - centre) / axes, axis=1)
            if not self.fade:
                return math.log(self.ratio) * (far < 1)
            # Falls from full to none over the band 1 - fade to 1 + fade, as half a cosine.
            part = np.clip((far - 1) / (2 * self.fade) + 0.5, 0, 1)
            return np.asarray(math.log(self.ratio) * 0.5 * (1 + np.cos(np.pi * part)))

        return replace(scene, ln_stiffness=(*scene.ln_stiffness, at))


@dataclass(frozen=True, slots=True)
class Ligament:
    """A stiff sheet through the body."""

    kind: ClassVar[str] = "ligament"
    effect: ClassVar[str | None] = None
    family: ClassVar[str | None] = "local stiffness"
    centre_mm: Triple
    normal: Triple
    reach_mm: float
    thickness_mm: float
    ratio: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        place = triple(rng.uniform(-0.35, 0.35, 3) * anatomy.half_mm + anatomy.centre_mm)
        return cls(
            place,
            direction(rng),
            rng.uniform(12.0, 25.0),
            rng.uniform(2.0, 4.0),
            log_uniform(rng, 4.0, 30.0),
        )

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        centre = np.array(self.centre_mm)
        normal = np.array(self.normal)

        def at(points: FloatArray) -> FloatArray:
            away = points - centre
            off = np.abs(away @ normal)
            along = np.linalg.norm(away - np.outer(away @ normal, normal), axis=1)
            return math.log(self.ratio) * ((off < self.thickness_mm / 2) & (along < self.reach_mm))

        return replace(scene, ln_stiffness=(*scene.ln_stiffness, at))
