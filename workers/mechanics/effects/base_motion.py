"""Let the base move between the recording at rest and that under load."""

from dataclasses import dataclass

from palpate.storage.values import FloatArray, IntArray, Triple
from palpate.workers.mechanics.effects.base import Effect, two_sided
from palpate.workers.mechanics.effects.problem_changes import unchanged
from palpate.workers.mechanics.effects.rigid_motion import rigid_columns
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import DEGREE, MM

SHIFTS = ("base_x", "base_y", "base_z")
TURNS = ("base_turn_x", "base_turn_y", "base_turn_z")


@dataclass(frozen=True, slots=True)
class BaseMotionColumns:
    """Move points with their base, which turns about `centre_mm`."""

    centre_mm: Triple

    def __call__(
        self, points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
    ) -> FloatArray:
        """Return normal motion for 1 mm along and 1 degree about each axis, shape (k, 6)."""
        return rigid_columns(points, normals, self.centre_mm)


def base_motion(centre_mm: Triple) -> Effect:
    """Move the body with its base, alike in all states, turning about `centre_mm`."""
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
        observation=BaseMotionColumns(centre_mm),
    )
