"""Causes outside the tissue: skin contact, chest wall, plates, forces, and wrong scans or labels.

Plates may rub, be curved, not parallel, or too short to reach the chest wall.
"""

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
class Friction:
    """Coulomb friction at both plates, slightly uneven along x."""

    kind: ClassVar[str] = "friction"
    effect: ClassVar[str | None] = "plate_friction"
    family: ClassVar[str | None] = "boundary"
    coefficient: float
    unevenness: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        return cls(log_uniform(rng, 0.04, 0.6), rng.uniform(-0.25, 0.25))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""

        def at(points: FloatArray) -> FloatArray:
            s = scene.anatomy.normalised(points)[:, 0]
            return np.asarray(self.coefficient * (1 + self.unevenness * np.sin(0.5 * np.pi * s)))

        return replace(scene, friction=(*scene.friction, at))


@dataclass(frozen=True, slots=True)
class WallCompliance:
    """A compliant chest wall, whose compliance varies as a cosine along x."""

    kind: ClassVar[str] = "wall_compliance"
    effect: ClassVar[str | None] = "wall_compliance"
    family: ClassVar[str | None] = "boundary"
    compliance_mm_per_kpa: float
    unevenness: float
    phase_deg: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        return cls(log_uniform(rng, 0.01, 0.5), rng.uniform(0.0, 0.6), rng.uniform(0, 360))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""

        def at(points: FloatArray) -> FloatArray:
            s = scene.anatomy.normalised(points)[:, 0]
            wave = np.cos(np.pi * s + math.radians(self.phase_deg))
            return np.asarray(self.compliance_mm_per_kpa * (1 + self.unevenness * wave))

        return replace(scene, wall_compliance=at)


@dataclass(frozen=True, slots=True)
class WallRise:
    """A part of the chest wall that breathing moves forward or back in the loaded scans."""

    kind: ClassVar[str] = "wall_rise"
    effect: ClassVar[str | None] = None
    family: ClassVar[str | None] = None
    x_mm: float
    y_mm: float
    radius_mm: float
    rise_mm: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        x, y = rng.uniform(-0.5, 0.5, 2) * (anatomy.half_mm[0], anatomy.half_mm[1])
        x += anatomy.centre_mm[0]
        size = sign(rng) * log_uniform(rng, 0.8, 6.0)
        return cls(float(x), float(y), rng.uniform(15.0, 35.0), size)

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""

        def at(points: FloatArray) -> FloatArray:
            far = np.hypot(points[:, 0] - self.x_mm, points[:, 1] - self.y_mm) / self.radius_mm
            return np.asarray(self.rise_mm * np.exp(-0.5 * far**2))

        return replace(scene, wall_rise_mm=at)


@dataclass(frozen=True, slots=True)
class Adhesion:
    """A scar that keeps tissue from sliding on a patch of the chest wall."""

    kind: ClassVar[str] = "adhesion"
    effect: ClassVar[str | None] = "local_attachment"
    family: ClassVar[str | None] = "boundary"
    x_mm: float
    y_mm: float
    radius_mm: float
    grip_kpa_per_mm: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        radius = rng.uniform(10.0, 25.0)
        r, angle = 0.6 * math.sqrt(rng.random()), rng.uniform(0, 2 * math.pi)
        across, along = r * math.cos(angle), r * math.sin(angle)
        along *= anatomy.upper_mm if along > 0 else anatomy.lower_mm
        grip = log_uniform(rng, 0.3, 10.0)
        return cls(along, across * anatomy.half_width_mm, radius, grip)

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""

        def at(points: FloatArray) -> FloatArray:
            far = np.hypot(points[:, 0] - self.x_mm, points[:, 1] - self.y_mm)
            return np.where(far < self.radius_mm, self.grip_kpa_per_mm, 0.0)

        return replace(scene, wall_grip=at)


@dataclass(frozen=True, slots=True)
class Tether:
    """Springs along all axes on the skin near the armpit, bounded by a sharp straight edge."""

    kind: ClassVar[str] = "tether"
    effect: ClassVar[str | None] = "local_attachment"
    family: ClassVar[str | None] = "boundary"
    azimuth_deg: float
    beyond_mm: float
    grip_kpa_per_mm: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a stiffness of 0.05 to 1 N/mm on part of the skin near the upper end."""
        azimuth = rng.uniform(-50.0, 50.0)
        share, n_per_mm = rng.uniform(0.06, 0.2), log_uniform(rng, 0.05, 1.0)
        points, areas = anatomy.skin()
        along = points @ _towards(azimuth)
        beyond = float(np.quantile(along, 1 - share))
        area = float(areas[along > beyond].sum())
        return cls(azimuth, beyond, 1e3 * n_per_mm / area)

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""

        def at(points: FloatArray) -> FloatArray:
            beyond = points @ _towards(self.azimuth_deg) > self.beyond_mm
            return np.where(beyond, self.grip_kpa_per_mm, 0.0)

        return replace(scene, skin_grip=at)


def _towards(azimuth_deg: float) -> FloatArray:
    """Return the unit vector along the chest wall at an angle to x, shape (3,)."""
    azimuth = math.radians(azimuth_deg)
    return np.array([math.cos(azimuth), math.sin(azimuth), 0.0])


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


@dataclass(frozen=True, slots=True)
class Segmentation:
    """Labels in the loaded scans that extend too far, or not far enough."""

    kind: ClassVar[str] = "segmentation"
    effect: ClassVar[str | None] = "segmentation_offset"
    family: ClassVar[str | None] = "observation"
    outline_mm: float
    glandular_mm: float

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random instance; see `Cause.draw`."""
        size, angle = log_uniform(rng, 0.1, 0.8), rng.uniform(0, 2 * math.pi)
        return cls(size * math.cos(angle), size * math.sin(angle))

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        return replace(scene, segmentation_mm=(self.outline_mm, self.glandular_mm))


@dataclass(frozen=True, slots=True)
class ImageScale:
    """Loaded scans scaled along one axis, about the centre of the body."""

    kind: ClassVar[str] = "image_scale"
    effect: ClassVar[str | None] = "image_scale"
    family: ClassVar[str | None] = "observation"
    scale: Triple
    centre_mm: Triple

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw an axis and a scale error of 0.3 to 2 %."""
        axis = int(rng.integers(3))
        part = sign(rng) * log_uniform(rng, 0.003, 0.02)
        return cls(triple(part * np.eye(3)[axis]), anatomy.centre_mm)

    def apply_to(self, scene: Scene) -> Scene:
        """Return the changed scene; see `Cause.apply_to`."""
        return replace(scene, image_scale=self.scale)
