"""Define what a cause is, and how its size is drawn.

A cause is drawn for an anatomy and put into a scene. Magnitudes are log-uniform over what
is plausible, so that a part of them lies below the noise of a segmentation.
"""

import math
from typing import ClassVar, Protocol, Self

import numpy as np

from palpate.storage.values import FloatArray, Triple
from palpate.workers.blind.scene import Anatomy, Scene

Rng = np.random.Generator


class Cause(Protocol):
    """Change one thing of the nominal physics.

    ``kind`` names it here; ``effect`` and ``family`` are the words in which a diagnosis
    would be right, None where it has none. Parameters are its fields, units in their names.
    """

    kind: ClassVar[str]
    effect: ClassVar[str | None]
    family: ClassVar[str | None]

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a cause at random for an anatomy."""
        ...

    def apply_to(self, scene: Scene) -> Scene:
        """Return the scene with this difference."""
        ...


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform between those of `low` and `high`."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def sign(rng: Rng) -> float:
    """Draw 1 or -1, both as likely."""
    return 1.0 if rng.random() < 0.5 else -1.0


def direction(rng: Rng) -> Triple:
    """Draw a unit vector, every one as likely."""
    vector = rng.standard_normal(3)
    return triple(vector / np.linalg.norm(vector))


def triple(vector: FloatArray) -> Triple:
    """Return the three numbers of an array (3,)."""
    x, y, z = vector.tolist()
    return x, y, z
