"""A section as labelled pixels for display."""

import numpy as np
from skimage.draw import polygon2mask

from palpate.storage.values import Volume
from palpate.workers.organs.cornea.section.outline import Section

CORNEA_LABEL = 5
PIXEL_MM = 0.01
MARGIN_PIXELS = 4


def section_image(section: Section, pixel_mm: float = PIXEL_MM) -> Volume:
    """Return a section as a volume of one slice, z = 0.

    Pixel centres are at integer multiples of the pixel size, so the images of two sections
    share one lattice.

    Parameters
    ----------
    section : Section
    pixel_mm : float
        > 0.

    Returns
    -------
    Volume
        `CORNEA_LABEL` where the centre of a pixel is inside the section, else 0.
    """
    outline = section.outline_mm / pixel_mm
    first = np.floor(outline.min(axis=0)).astype(int) - MARGIN_PIXELS
    columns, rows = np.ceil(outline.max(axis=0)).astype(int) + MARGIN_PIXELS - first + 1
    inside = polygon2mask((int(rows), int(columns)), (outline - first)[:, ::-1])
    x, y = (pixel_mm * first).tolist()
    return Volume(
        (CORNEA_LABEL * inside[None]).astype(np.uint8), (pixel_mm, pixel_mm, pixel_mm), (x, y, 0.0)
    )
