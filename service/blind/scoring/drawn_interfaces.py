"""Computes how far outside of a body its interfaces are drawn: labels or scans that are too large,
and scans that lie elsewhere."""

from collections.abc import Mapping

import numpy as np

from palpate.service.blind.scoring.magnitudes import SCALES
from palpate.storage.values import FloatArray, IntArray, Triple
from palpate.workers.mechanics.effects.observation import RIGID_MOTION, rigid_columns

# Labels that are drawn too large, by the interface that they move.
OFFSETS_MM = ("segmentation_fat_mm", "segmentation_glandular_mm")
# How tissue has moved between the scans, in mm and degrees: the interface lies where it has gone.
MOTIONS = tuple(p.door_name for p in RIGID_MOTION.parameters)


def drawn_mm(
    points: FloatArray,
    normals: FloatArray,
    interface: IntArray,
    centre_mm: Triple | None,
    sizes: Mapping[str, float],
) -> FloatArray:
    """Return the distance along the normals, shape (scans, k).

    Parameters
    ----------
    points, normals : ndarray, shape (scans, k, 3)
        In the loaded scans, in mm, and unit normals of the interfaces there.
    interface : ndarray of int, shape (k,)
        0 for the outline, 1 for the boundary of the glandular tissue.
    centre_mm : tuple of float or None
        About which scans are too large or turned; without it scales and motions are left out.
    sizes : mapping of str to float
        Parameters of the catalogue under their door names; 0 for those that are not named.
    """
    offsets = np.array([sizes.get(name, 0.0) for name in OFFSETS_MM])[interface]
    out = np.broadcast_to(offsets, points.shape[:2])
    if centre_mm is None:
        return out
    scales = np.array([sizes.get(name, 0.0) for name in SCALES])
    motion = np.array([sizes.get(name, 0.0) for name in MOTIONS])
    moved = [rigid_columns(p, n, centre_mm) @ motion for p, n in zip(points, normals, strict=True)]
    return np.asarray(out + ((points - np.asarray(centre_mm)) * normals) @ scales + moved)
