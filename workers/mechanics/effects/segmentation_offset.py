"""Draw labels too large or too small."""

import numpy as np

from palpate.storage.values import FloatArray, IntArray, Tissue
from palpate.workers.mechanics.effects.base import Effect, two_sided
from palpate.workers.mechanics.effects.problem_changes import unchanged
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import MM

TISSUES = (Tissue.FAT, Tissue.GLANDULAR, Tissue.SKIN, Tissue.MUSCLE)


def columns(points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame) -> FloatArray:
    """Return 1 where an interface encloses the tissue, shape (k, 4); see `Effect.shift`."""
    return np.equal.outer(np.asarray(tissues), np.array(TISSUES)).astype(np.float64)


SEGMENTATION_OFFSET = Effect(
    name="segmentation_offset",
    family="observation",
    summary="The labels of a tissue are drawn too large or too small.",
    parameters=tuple(
        two_sided(
            f"segmentation_{tissue.name.lower()}",
            MM,
            2.0,
            f"how far the labels of {tissue.name.lower()} reach beyond its true boundary",
        )
        for tissue in TISSUES
    ),
    prior_sd=(0.35,) * len(TISSUES),
    steps=(0.01,) * len(TISSUES),
    transform=unchanged,
    references=("M. A. Lago, PhD thesis, 2014, section 4.5.7",),
    observation=columns,
)
