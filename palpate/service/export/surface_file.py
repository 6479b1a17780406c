"""Export of a body's surface as triangles, binary `.stl`.

The file has a header of 80 bytes, the number of triangles, and for each its unit normal, three
corners and two spare bytes, all little-endian in single precision. STL has no units; coordinates
are in mm.
"""

from pathlib import Path

import numpy as np

from palpate.storage.backends.atomic import explained, write_file
from palpate.storage.values import FloatArray, IntArray

TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])


def export_surface(path: Path, nodes: FloatArray, triangles: IntArray) -> None:
    """Write triangles.

    Parameters
    ----------
    path : Path
    nodes : ndarray, shape (n, 3)
        In mm.
    triangles : ndarray, shape (k, 3)
        Corners, counter-clockwise when seen from outside.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    corners = nodes[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    written = np.zeros(len(triangles), TRIANGLE)
    written["normal"] = normal / np.maximum(size, 1e-30)
    written["corners"] = corners
    # A binary file must not begin with "solid", which marks a text file.
    header = b"Palpate, units mm".ljust(80) + np.uint32(len(triangles)).tobytes()
    with explained(path):
        write_file(path, header + written.tobytes())
