"""Let markers stand off the surface on which they are believed to sit."""

import numpy as np

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.effects.base import Effect, from_zero
from palpate.workers.mechanics.effects.problem_changes import unchanged
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import MM

NAME = "marker_standoff"


def columns(arms: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame) -> FloatArray:
    """Return how an arm's end (1 mm) moves against its foot, along the normals, shape (k, 1).

    The arm stands on the surface and turns with it, so what it adds is exact for any
    turn, and linear in its length.
    """
    return np.asarray((arms * normals).sum(axis=1)[:, None])


MARKER_STANDOFF = Effect(
    name="marker_standoff",
    family="observation",
    summary="The markers stand off the surface and swing out as it turns.",
    parameters=(from_zero(NAME, MM, 15.0, "height of the markers above the surface"),),
    prior_sd=(5.0,),
    steps=(0.01,),
    transform=unchanged,
    references=(
        "A. Cappozzo et al., Clin. Biomech. 11 (1996) 90: markers that move "
        "against what they stand for",
    ),
    observation=columns,
    sees="arms",
)
