"""Causes that make scans or labels wrong."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from palpate.storage.values import Triple
from palpate.workers.blind.causes.base import Rng, log_uniform, sign, triple
from palpate.workers.blind.scene import Anatomy, Scene


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
