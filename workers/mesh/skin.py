"""Whether a mesh is fine enough for the layer of skin."""

import numpy as np

from storage.values import Tissue, Volume
from workers.mesh.hierarchy import Hierarchy
from workers.mesh.outline import outline_of


def skin_thickness_mm(labels: Volume) -> float:
    """Mean thickness of the skin: its volume over the free area of the body; 0 without skin."""
    skin_mm3 = np.count_nonzero(labels.values == Tissue.SKIN) * labels.voxel_mm3
    if not skin_mm3:
        return 0.0
    longest = float(np.max(np.asarray(labels.shape_xyz) * labels.spacing_mm))
    return skin_mm3 / outline_of(labels, longest / 150).free_area_mm2


def skin_resolved(hierarchy_or_size: Hierarchy | float, labels: Volume) -> bool:
    """Whether the elements are as small as the layer of skin is thick.

    Parameters
    ----------
    hierarchy_or_size : Hierarchy or float
        Meshes, or the cell size of the finest one in mm.
    labels : Volume
        Tissue labels. Without any `Tissue.SKIN` there is no layer to resolve: False.
    """
    size = hierarchy_or_size
    if isinstance(size, Hierarchy):
        size = size.element_size_mm
    return float(size) <= skin_thickness_mm(labels)
