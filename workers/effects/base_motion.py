"""A base that moved between the recording at rest and that under load."""

from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray, IntArray, Triple
from workers.effects.base import Effect, two_sided
from workers.effects.replaced import unchanged
from workers.fem.fields import Frame
from workers.units import DEGREE, MM

SHIFTS = ("base_x", "base_y", "base_z")
TURNS = ("base_turn_x", "base_turn_y", "base_turn_z")


@dataclass(frozen=True, slots=True)
class Carried:
    """How points move with their base, which turns about `centre_mm`."""

    centre_mm: Triple

    def __call__(
        self, points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
    ) -> FloatArray:
        """Along the normals for 1 mm along and 1 degree about each axis, shape (k, 6)."""
        arm = np.asarray(points) - np.asarray(self.centre_mm)
        # n . (w x r) = w . (r x n)
        return np.hstack([normals, np.radians(np.cross(arm, normals))])


def base_motion(centre_mm: Triple) -> Effect:
    """Rigid motion with the base, alike in all states, turning about `centre_mm`."""
    return Effect(
        name="base_motion",
        family="boundary",
        summary="The base moved when the load came on, and the body with it.",
        parameters=(
            *(two_sided(n, MM, 3.0, f"shift of the base along {n[-1]}") for n in SHIFTS),
            *(two_sided(n, DEGREE, 3.0, f"turn of the base about {n[-1]}") for n in TURNS),
        ),
        prior_sd=(0.3,) * 3 + (0.3,) * 3,
        steps=(0.01,) * 6,
        transform=unchanged,
        references=("J. M. Fitzpatrick, J. B. West, C. R. Maurer, IEEE TMI 17 (1998) 694",),
        observation=Carried(centre_mm),
    )
