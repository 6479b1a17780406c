"""Move the body between the scans, as far as the registration has left it."""

import numpy as np

from palpate.storage.values import FloatArray, IntArray, Triple
from palpate.workers.mechanics.effects.base import Effect, two_sided
from palpate.workers.mechanics.effects.problem_changes import unchanged
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import DEGREE, MM

SHIFTS = ("motion_x", "motion_y", "motion_z")
TURNS = ("motion_turn_x", "motion_turn_y", "motion_turn_z")


def rigid_columns(points: FloatArray, normals: FloatArray, centre_mm: Triple) -> FloatArray:
    """Return normal motion for 1 mm along and 1 degree about each axis, shape (k, 6).

    Turns are about `centre_mm` and linearised: of r theta^2 / 2 they know nothing, which
    is 0.12 mm for 3 degrees at 85 mm. See `Effect.shift`.
    """
    arm = np.asarray(points) - np.asarray(centre_mm)
    # n . (w x r) = w . (r x n)
    return np.hstack([normals, np.radians(np.cross(arm, normals))])


def rigidly_moved(points: FloatArray, motion: FloatArray, centre_mm: Triple) -> FloatArray:
    """Return points after a motion of 3 shifts in mm and 3 turns in degrees, shape (k, 3).

    As linear as `rigid_columns`.
    """
    turn = np.radians(motion[3:])
    return np.asarray(points + motion[:3] + np.cross(turn, points - np.asarray(centre_mm)))


def columns(points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame) -> FloatArray:
    """Return the columns of a motion that turns about the middle of the body, shape (k, 6)."""
    return rigid_columns(points, normals, frame.centre_mm)


# Every scan lies elsewhere by what a registration leaves, whatever the hypothesis; that all loaded
# scans share another motion beyond that is as rare as a scanner with a wrong scale.
RIGID_MOTION = Effect(
    name="rigid_motion",
    family="observation",
    summary="The two scans are not perfectly aligned.",
    parameters=(
        *(two_sided(n, MM, 5.0, f"shift of the deformed scan along {n[-1]}") for n in SHIFTS),
        *(two_sided(n, DEGREE, 3.0, f"turn of the deformed scan about {n[-1]}") for n in TURNS),
    ),
    prior_sd=(1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
    steps=(0.01,) * 6,
    transform=unchanged,
    references=("J. M. Fitzpatrick, J. B. West, C. R. Maurer, IEEE TMI 17 (1998) 694",),
    observation=columns,
    odds=0.1,
)
