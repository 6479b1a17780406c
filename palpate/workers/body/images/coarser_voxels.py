"""Label volumes on coarser lattices."""

import numpy as np

from palpate.storage.values import Volume
from palpate.workers.body.images.labels import resample_labels


def in_coarser_voxels(volume: Volume, spacing_mm: float) -> Volume:
    """Resample a volume over the same box at a coarser spacing, by nearest neighbour.

    A volume whose voxels are already (almost) that large is returned unchanged.
    """
    if max(volume.spacing_mm) > spacing_mm * (1 - 1e-6):
        return volume
    spacing = np.asarray(volume.spacing_mm)
    size = spacing * np.asarray(volume.shape_xyz)
    nx, ny, nz = (int(n) for n in np.ceil(size / spacing_mm - 1e-6))
    ox, oy, oz = (float(o) for o in volume.origin_mm - spacing / 2 + spacing_mm / 2)
    three = (spacing_mm, spacing_mm, spacing_mm)
    return resample_labels(volume, Volume(np.empty((nz, ny, nx), np.uint8), three, (ox, oy, oz)))
