"""Turn the frame of the cameras against that of the body."""

import numpy as np

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.effects.base import Effect, two_sided
from palpate.workers.mechanics.effects.problem_changes import unchanged
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import DEGREE

TURNS = ("frame_turn_x", "frame_turn_y", "frame_turn_z")


def columns(moves: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame) -> FloatArray:
    """Return how 1 degree about each axis shifts displacements along the normals, shape (k, 3)."""
    return np.asarray(np.radians(np.cross(moves, normals)))


# What a fit to markers 0.5 mm off their places leaves, with the base 30 mm wide.
FRAME_TURN = Effect(
    name="frame_turn",
    family="observation",
    summary="The cameras' frame is turned against the body's: markers are not where they "
    "are believed to be at rest.",
    parameters=tuple(
        two_sided(n, DEGREE, 5.0, f"turn of the observed displacements about {n[-1]}")
        for n in TURNS
    ),
    prior_sd=(1.0, 1.0, 1.0),
    steps=(0.01,) * 3,
    transform=unchanged,
    references=("J. M. Fitzpatrick, J. B. West, C. R. Maurer, IEEE TMI 17 (1998) 694",),
    observation=columns,
    sees="moves",
)
