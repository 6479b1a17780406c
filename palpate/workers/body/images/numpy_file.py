"""NumPy arrays, indexed ``[z, y, x]`` like every volume here.

They have no spacing and no frame: spacing must be given, and the first voxel is
at (0, 0, 0).
"""

from pathlib import Path

import numpy as np

from palpate.workers.body.images.claimed_size import check_stored, claimed_bytes
from palpate.workers.body.images.scan import Scan, three_axes


def read_numpy(path: Path) -> Scan:
    """Read an ``.npy`` file (never one with pickled objects)."""
    with path.open("rb") as file:
        version = np.lib.format.read_magic(file)
        read = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read(file)
        if not dtype.hasobject:  # objects are refused below
            size = claimed_bytes(shape, dtype.itemsize, str(path))
            check_stored(size, path.stat().st_size - file.tell(), 1, str(path))
        file.seek(0)
        values = np.lib.format.read_array(file, allow_pickle=False)
    return Scan.without_frame(three_axes(values, str(path)).transpose())
