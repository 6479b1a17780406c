"""Distances from a body's true interfaces to the drawn ones.

The distances are due to labels or scans that are too large, and to displaced scans.
"""

from collections.abc import Mapping

import numpy as np

from palpate.service.blind.sealed.truth import CATALOGUE
from palpate.storage.values import FloatArray, IntArray, Tissue, Triple
from palpate.workers.mechanics.fem.problem.fields import Frame


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
        Points in the loaded scans, in mm, and unit normals of the interfaces there.
    interface : ndarray of int, shape (k,)
        0 for the outline, 1 for the boundary of the glandular tissue.
    centre_mm : tuple of float or None
        Centre about which scans are scaled, sheared or turned; without it these are ignored.
    sizes : mapping of str to float
        Parameters of the catalogue under their external names; missing ones are 0.
    """
    tissues = np.where(interface == 0, Tissue.FAT, Tissue.GLANDULAR)
    frame = Frame() if centre_mm is None else Frame(centre_mm)
    out = np.zeros(points.shape[:2])
    for effect in CATALOGUE.on_observation:
        if centre_mm is None and effect.about_centre:
            continue
        values = {
            p.name: p.unit.to_inside(sizes[p.door_name])
            for p in effect.parameters
            if p.door_name in sizes
        }
        for scan, (at, normal) in enumerate(zip(points, normals, strict=True)):
            out[scan] += effect.shift(at, normal, tissues, values, frame)
    return out
