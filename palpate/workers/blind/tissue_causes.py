"""Causes in the tissue: changed everywhere, in one place, or by water between the scans."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.blind.breast_scene import (
    Anatomy,
    Rng,
    Scene,
    direction,
    log_uniform,
    sign,
    triple,
)


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
