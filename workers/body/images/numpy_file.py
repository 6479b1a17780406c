"""Read a NumPy array, indexed ``[z, y, x]`` like every volume of the house.

It carries no spacing and no frame: spacing must be given, the first voxel is
at (0, 0, 0).
"""

from pathlib import Path

import numpy as np

from palpate.workers.body.images.scan import Scan, three_axes


def read_numpy(path: Path) -> Scan:
    """Read an ``.npy`` file (never one that holds pickled objects)."""
    values = np.load(path, allow_pickle=False)
    return Scan.without_frame(three_axes(values, str(path)).transpose())
