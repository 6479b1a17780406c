"""The score of two rasterised sections, as an independent reference."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt

from palpate.workers.organs.cornea.section_outline import Section


def drawn(outline: NDArray[np.float64], shape: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return a mask of the pixels [x, y] whose centres, at whole numbers, are inside a polygon."""
    image = np.zeros(shape, dtype=bool)
    x0, y0 = outline.T
    x1, y1 = np.roll(outline, -1, axis=0).T
    for column in range(shape[0]):
        hit = (x0 <= column) != (x1 <= column)
        slope = (y1[hit] - y0[hit]) / (x1[hit] - x0[hit])
        crossings = np.sort(y0[hit] + slope * (column - x0[hit]))
        for bottom, top in crossings.reshape(-1, 2):
            image[column, int(np.ceil(bottom)) : int(np.ceil(top))] = True
    return image


def rasterised_score(a: Section, b: Section, pixel_um: float) -> tuple[float, float]:
    """Return the Jaccard coefficient and modified Hausdorff distance (um) of the rasters."""
    pixel_mm = pixel_um / 1000
    points = np.concatenate([a.outline_mm, b.outline_mm])
    lower = points.min(axis=0) - 3 * pixel_mm
    shape = np.ceil((points.max(axis=0) - lower) / pixel_mm).astype(int) + 3
    images = [drawn((section.outline_mm - lower) / pixel_mm, shape) for section in (a, b)]
    first, second = images
    jc = float((first & second).sum() / (first | second).sum())
    edges = [image & ~binary_erosion(image) for image in images]
    to_second = distance_transform_edt(~edges[1])[edges[0]].mean()
    to_first = distance_transform_edt(~edges[0])[edges[1]].mean()
    return jc, float(max(to_second, to_first)) * pixel_um
