"""Let the loaded scans be sheared against that at rest."""

import numpy as np

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.effects.base import Effect, two_sided
from palpate.workers.mechanics.effects.problem_changes import unchanged
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import Reading
from palpate.workers.units import NUMBER

NAMES = ("shear_xy", "shear_xz", "shear_yz")
# What is moved, along which axis, and in proportion to which coordinate.
MOVED, BY = (0, 0, 1), (1, 2, 2)


def columns(points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame) -> FloatArray:
    """Return normal motion where planes slide over each other, shape (k, 3).

    For a shear of one about the middle of the body; see `Effect.shift`. The other three shears
    are these and a turn, which the pose of a scan has.
    """
    arms = points - np.asarray(frame.centre_mm)
    return np.asarray(normals[:, MOVED] * arms[:, BY])


# A gantry that stands a quarter of a degree off, or what is left of a distortion.
IMAGE_SHEAR = Effect(
    name="image_shear",
    family="observation",
    summary="The loaded scans are sheared against the scan at rest.",
    parameters=tuple(
        two_sided(
            name,
            NUMBER,
            0.05,
            f"how far they are moved along {name[-2]} by 1 mm of {name[-1]}",
            reading=Reading(unit=f"mm along {name[-2]} for each mm of {name[-1]}"),
        )
        for name in NAMES
    ),
    prior_sd=(0.005,) * len(NAMES),
    steps=(1e-4,) * len(NAMES),
    transform=unchanged,
    references=("D. Wang et al., Magn. Reson. Imaging 22 (2004) 1211",),
    observation=columns,
    odds=0.1,
)
