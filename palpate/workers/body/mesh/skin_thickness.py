"""Thickness of the skin layer."""

import numpy as np

from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.outline import outline_of


def skin_thickness_mm(labels: Volume) -> float:
    """Return the mean thickness: skin volume over free area of the body; 0 without skin."""
    skin_mm3 = np.count_nonzero(labels.values == Tissue.SKIN) * labels.voxel_mm3
    if not skin_mm3:
        return 0.0
    longest = float(np.max(np.asarray(labels.shape_xyz) * labels.spacing_mm))
    return skin_mm3 / outline_of(labels, longest / 150).free_area_mm2
