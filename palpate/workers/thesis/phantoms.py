"""The ten phantoms of thesis sections 4.4 and 4.5."""

from dataclasses import replace

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.phantom.breast import BreastPhantom, Phantom, generate_breast
from palpate.workers.thesis.scale import Scale, check_scale

COUNT = 10
SPARSEST, DENSEST = 0.07, 0.35
# The thesis gives 250 ml and 170 x 100 x 50 mm, but a body of that size has 445 ml; this one has
# 250 ml, and voxels of 0.2 mm.
FULL = BreastPhantom.preset("250ml", spacing_mm=0.2)
# An eighth of that volume, with compartments, ligaments and skin of the same size.
REDUCED = BreastPhantom(
    lower_mm=18.75,
    upper_mm=66.25,
    half_width_mm=18.75,
    depth_mm=18.75,
    compartments=42,
    spacing_mm=0.3,
)

# The same body in coarse voxels.
SKETCH = replace(REDUCED, spacing_mm=1.0)
SETTINGS: dict[Scale, BreastPhantom] = {"sketch": SKETCH, "reduced": REDUCED, "full": FULL}
# Phantoms used by an experiment: a sketch uses one of the first five and one of the others.
NUMBERS: dict[Scale, tuple[int, ...]] = {
    "sketch": (3, 8),
    "reduced": tuple(range(1, COUNT + 1)),
    "full": tuple(range(1, COUNT + 1)),
}


def density_of(number: int) -> float:
    """Return the glandular fraction of phantom `number`, 1 to 10, evenly spaced from 7 to 35 %."""
    if not 1 <= number <= COUNT:
        raise InputError(f"The number of a phantom must be 1 to {COUNT}, got {number}.")
    return float(np.linspace(SPARSEST, DENSEST, COUNT)[number - 1])


def thesis_phantom(number: int, scale: Scale = "reduced") -> Phantom:
    """Return phantom `number`; all have the same outline, but different compartments.

    Parameters
    ----------
    number : int
        1 to 10, from the sparsest to the densest.
    scale : {"sketch", "reduced", "full"}

    Raises
    ------
    InputError
        If the number or the scale is unknown.
    """
    check_scale(scale)
    return generate_breast(replace(SETTINGS[scale], glandular_fraction=density_of(number)), number)


def two_materials(labels: Volume) -> Volume:
    """Return labels of gland and fat; skin and ligaments count as fat (thesis section 4.4.1)."""
    values = np.where(labels.values == Tissue.AIR, Tissue.AIR, Tissue.FAT).astype(np.uint8)
    values[labels.values == Tissue.GLANDULAR] = Tissue.GLANDULAR
    return replace(labels, values=values)
