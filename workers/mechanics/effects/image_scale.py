"""Let the loaded scans have another scale than that at rest."""

import numpy as np

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.effects.base import Effect, two_sided
from palpate.workers.mechanics.effects.problem_changes import unchanged
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import percent
from palpate.workers.units import NUMBER

NAMES = ("scale_x", "scale_y", "scale_z")


def columns(points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame) -> FloatArray:
    """Return normal motion where everything grows about the middle of the body, shape (k, 3).

    For a scale that is larger by one; see `Effect.shift`.
    """
    return np.asarray((points - np.asarray(frame.centre_mm)) * normals)


# Distortions of MR images that are left after correction: 1 % is much, and scans of one scanner
# share them. Voxels alone can look like a scale that is off by a tenth of that.
IMAGE_SCALE = Effect(
    name="image_scale",
    family="observation",
    summary="The loaded scans have another scale than the scan at rest.",
    parameters=tuple(
        two_sided(
            name,
            NUMBER,
            0.05,
            f"how much larger they show the body along {name[-1]}",
            reading=percent(f"% larger along {name[-1]}"),
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
