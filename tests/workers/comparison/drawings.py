"""Volumes drawn with characters, and distances computed directly."""

import numpy as np
from scipy.ndimage import binary_erosion, distance_transform_edt

from palpate.storage.values import Tissue, Volume


def draw(text: str, spacing_mm=(1.0, 1.0, 1.0)) -> Volume:
    """Parse characters along x, rows along y and planes separated by ``-``; ``#`` is glandular."""
    planes = [plane.split() for plane in text.split("-")]
    values = np.array([[[c == "#" for c in row] for row in plane] for plane in planes])
    return of_mask(values, spacing_mm)


def of_mask(mask, spacing_mm=(1.0, 1.0, 1.0), origin_mm=(0.0, 0.0, 0.0)) -> Volume:
    """Return glandular tissue where the mask is true, fat elsewhere."""
    values = np.where(mask, Tissue.GLANDULAR, Tissue.FAT).astype(np.uint8)
    return Volume(values, spacing_mm, origin_mm)


def mhd_by_distance_transforms(x, y, spacing_mm, surface: str) -> float:
    """Return the modified Hausdorff distance of two masks in one box, computed by scipy."""
    if surface == "boundary":
        x, y = x & ~binary_erosion(x), y & ~binary_erosion(y)
    to_x = distance_transform_edt(~x, sampling=spacing_mm[::-1])
    to_y = distance_transform_edt(~y, sampling=spacing_mm[::-1])
    return max(to_y[x].mean(), to_x[y].mean())
