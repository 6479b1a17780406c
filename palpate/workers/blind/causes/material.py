"""Causes that change tissue everywhere."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.blind.causes.base import Rng, log_uniform, sign
from palpate.workers.blind.scene import Anatomy, Scene


@dataclass(frozen=True, slots=True)
class Gradient:
    """Tissue that is stiffer towards one side: ln of the stiffness is a tanh along a direction."""

    kind: ClassVar[str] = "gradient"
    effect: ClassVar[str | None] = "stiffness_gradient"
    family: ClassVar[str | None] = "global material"
    ln_x: float
    ln_y: float
    ln_z: float
    steepness: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        # Along the depth or cranio-caudal axis, with small components along the other axes.
        main = np.eye(3)[2 if rng.random() < 0.5 else 0] * sign(rng)
        mixed = main + 0.2 * rng.standard_normal(3)
        x, y, z = log_uniform(rng, 0.08, 1.0) * mixed / np.linalg.norm(mixed)
        return cls(float(x), float(y), float(z), rng.uniform(0.8, 2.0))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        size = np.array([self.ln_x, self.ln_y, self.ln_z])
        length = float(np.linalg.norm(size))

        def at(points: FloatArray) -> FloatArray:
            s = scene.anatomy.normalised(points) @ (size / length)
            return np.asarray(length * np.tanh(self.steepness * s) / math.tanh(self.steepness))

        return replace(scene, ln_stiffness=(*scene.ln_stiffness, at))


@dataclass(frozen=True, slots=True)
class Fibres:
    """Fibres rotated by an angle that grows away from the wall and fans out across the body."""

    kind: ClassVar[str] = "fibres"
    effect: ClassVar[str | None] = "fibre_rotation"
    family: ClassVar[str | None] = "global material"
    turn_deg: float
    azimuth_deg: float
    fan_deg: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        turn = log_uniform(rng, 2.0, 25.0)
        return cls(turn, rng.uniform(0, 360), turn * rng.uniform(-0.3, 0.3))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        azimuth = math.radians(self.azimuth_deg)
        towards = np.array([math.cos(azimuth), math.sin(azimuth)])

        def at(points: FloatArray) -> FloatArray:
            place = scene.anatomy.normalised(points)
            angle = np.radians(self.turn_deg + self.fan_deg * (place[:, :2] @ towards))
            sine = np.sin(angle)
            return np.column_stack([sine * towards[0], sine * towards[1], np.cos(angle)])

        return replace(scene, fibres=at)


@dataclass(frozen=True, slots=True)
class Stiffening:
    """Fung's exponential law instead of the neo-Hookean law."""

    kind: ClassVar[str] = "stiffening"
    effect: ClassVar[str | None] = "strain_stiffening"
    family: ClassVar[str | None] = "global material"
    exponent: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        return cls(log_uniform(rng, 0.3, 8.0))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        return replace(scene, fung=self.exponent)


@dataclass(frozen=True, slots=True)
class SkinSheet:
    """A skin that resists stretching."""

    kind: ClassVar[str] = "skin"
    effect: ClassVar[str | None] = "skin_added"
    family: ClassVar[str | None] = "global material"
    stiffness_n_per_m: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        return cls(log_uniform(rng, 20.0, 1500.0))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        return replace(scene, skin_n_per_m=self.stiffness_n_per_m)


@dataclass(frozen=True, slots=True)
class FibreContrast:
    """Fibres that are stiffer or softer in glandular tissue than in fat, unevenly along z."""

    kind: ClassVar[str] = "fibre_contrast"
    effect: ClassVar[str | None] = "fibre_contrast"
    family: ClassVar[str | None] = "global material"
    ratio: float
    unevenness: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a ratio of 1.5 to 6, or its reciprocal."""
        return cls(log_uniform(rng, 1.5, 15.0) ** sign(rng), rng.uniform(-0.25, 0.25))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""

        def at(points: FloatArray) -> FloatArray:
            s = scene.anatomy.normalised(points)[:, 2]
            wave = np.sin(0.5 * np.pi * s)
            return np.asarray(math.log(self.ratio) * (1 + self.unevenness * wave))

        return replace(scene, ln_gland_fibres=at)
