"""The interface of causes, and random draws of their magnitudes.

A cause is drawn for an anatomy and applied to a scene. Magnitudes are log-uniform over a plausible
range, so that the effects of some are below the noise of a segmentation.
"""

import math
from typing import ClassVar, Protocol, Self

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.blind.scene import Anatomy, Scene

Rng = np.random.Generator


class Cause(Protocol):
    """A single deviation from the nominal physics.

    ``kind`` is its name here; ``effect`` and ``family`` are the correct answers of a diagnosis,
    None if there is none. Its fields are the parameters, with units in their names.
    """

    kind: ClassVar[str]
    effect: ClassVar[str | None]
    family: ClassVar[str | None]

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random cause for an anatomy."""
        ...

    def apply_to(self, scene: Scene) -> Scene:
        """Return the scene with this deviation."""
        ...


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform between the logarithms of `low` and `high`."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def sign(rng: Rng) -> float:
    """Draw 1 or -1 with equal probability."""
    return 1.0 if rng.random() < 0.5 else -1.0


def direction(rng: Rng) -> Triple:
    """Draw a unit vector, uniformly distributed."""
    vector = rng.standard_normal(3)
    return triple(vector / np.linalg.norm(vector))


def triple(vector: FloatArray) -> Triple:
    """Return the three numbers of an array (3,)."""
    x, y, z = vector.tolist()
    return x, y, z
