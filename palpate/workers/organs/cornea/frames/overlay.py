"""A frame with contours drawn on it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.frames.frame import Frame
from palpate.workers.organs.cornea.section.polyline import arclength_mm, points_at

Colour = tuple[int, int, int]
# The brightest pixels are clipped, so that tissue stays visible next to a reflex.
WHITE_PERCENTILE = 99.8


def overlay(
    frame: Frame, contours: Sequence[tuple[FloatArray, Colour]], width_px: float = 1.0
) -> NDArray[np.uint8]:
    """Return a frame as a colour image with contours drawn on it.

    Parameters
    ----------
    frame : Frame
    contours : sequence of (ndarray, colour)
        Polylines (n, 2) in mm in the coordinates of the frame, with red, green and blue from
        0 to 255; later ones are on top. Parts outside the image are not drawn.
    width_px : float
        Width of the lines; > 0.

    Returns
    -------
    ndarray of uint8, shape (rows, columns, 3)
    """
    black, white = np.percentile(frame.grey, [1.0, WHITE_PERCENTILE])
    grey = np.clip((frame.grey - black) / max(white - black, 1e-12), 0.0, 1.0)
    picture = np.repeat(255 * grey[:, :, None], 3, axis=2)
    for contour, colour in contours:
        cover = _coverage(frame.to_pixels(contour), grey.shape, width_px)[:, :, None]
        picture = (1 - cover) * picture + cover * np.array(colour, dtype=np.float64)
    return np.rint(picture).astype(np.uint8)


def _coverage(line: FloatArray, shape: tuple[int, ...], width: float) -> FloatArray:
    """Return the fraction of each pixel covered by a line, from its nearest sample."""
    length = float(arclength_mm(line)[-1])
    dense = points_at(line, np.linspace(0.0, length, int(np.ceil(4 * length)) + 1))
    cover = np.zeros(shape)
    reach = int(np.ceil(width / 2 + 0.5))
    base = np.rint(dense).astype(np.int64)
    for dx in range(-reach, reach + 1):
        for dy in range(-reach, reach + 1):
            column, row = base[:, 0] + dx, base[:, 1] + dy
            inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
            far = np.hypot(column - dense[:, 0], row - dense[:, 1])[inside]
            part = np.clip(0.5 + width / 2 - far, 0.0, 1.0)
            np.maximum.at(cover, (row[inside], column[inside]), part)
    return cover
