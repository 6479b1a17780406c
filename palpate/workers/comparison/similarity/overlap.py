"""Overlap of two sets of voxels (Eqs. 3.17 and 3.18 of the thesis)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.workers.comparison.similarity.voxel_set import VoxelSet
from palpate.workers.compile_flags import EXACT


def intersection_count(x: VoxelSet, y: VoxelSet) -> int:
    """Count the voxels in both sets."""
    start = [max(a, b) for a, b in zip(x.start, y.start, strict=True)]
    stop = [min(a, b) for a, b in zip(x.stop, y.stop, strict=True)]
    if any(a >= b for a, b in zip(start, stop, strict=True)):
        return 0
    views = [
        s.mask[tuple(slice(a - o, b - o) for a, b, o in zip(start, stop, s.start, strict=True))]
        for s in (x, y)
    ]
    return int(_count_both(*views))


def jaccard(intersection: int, count_x: int, count_y: int) -> float:
    r"""Return the Jaccard coefficient :math:`|X \cap Y| / |X \cup Y|`; 1 for two empty sets."""
    union = count_x + count_y - intersection
    return intersection / union if union else 1.0


def dice(jc: float) -> float:
    """Return the Dice coefficient ``2 JC / (JC + 1)``."""
    return 2.0 * jc / (jc + 1.0)


@njit(**EXACT)
def _count_both(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> int:
    total = 0
    for z in range(a.shape[0]):
        for y in range(a.shape[1]):
            p, q = a[z, y], b[z, y]
            line = 0
            for x in range(a.shape[2]):
                line += (p[x] != 0) & (q[x] != 0)
            total += line
    return total
