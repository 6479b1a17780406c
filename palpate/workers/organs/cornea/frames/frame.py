"""A greyscale image of a cornea with the size of its pixels."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a corneal section, such as those taken by a tonometer during an air puff.

    The centre of the pixel ``grey[row, column]`` is at x = (column + first column) * spacing x,
    y = -(row + first row) * spacing y: x to the right, y upwards, which is out of the eye.

    Parameters
    ----------
    grey : ndarray, shape (rows, columns)
        Grey values; the cornea is brighter than its surroundings above and below.
    spacing_mm : tuple of float
        Width and height of a pixel; > 0, and different on a Corvis.
    first_pixel : tuple of float
        Column and row of the first pixel in the raster of the camera, shared by all frames of a
        sequence, if this frame has been cropped.

    Raises
    ------
    InputError
        If the image is not a greyscale one of at least 16 x 16 pixels, has values that are not
        finite, or a spacing is not positive.
    """

    grey: FloatArray
    spacing_mm: tuple[float, float]
    first_pixel: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if self.grey.ndim != 2 or min(self.grey.shape) < 16:
            raise InputError(
                "A frame of a cornea needs at least 16 x 16 grey values, found an array of shape "
                f"{self.grey.shape}."
            )
        if not np.isfinite(self.grey).all():
            raise InputError("The frame of the cornea has grey values that are not finite.")
        if not all(np.isfinite(s) and s > 0 for s in self.spacing_mm):
            raise InputError(
                f"The pixels of a frame need a positive width and height, got {self.spacing_mm} mm."
            )

    def to_mm(self, columns: FloatArray, rows: FloatArray) -> FloatArray:
        """Return the points (x, y) in mm for positions in pixels of this image."""
        pixels = np.column_stack([columns, rows]) + self.first_pixel
        return np.asarray(pixels * [self.spacing_mm[0], -self.spacing_mm[1]])

    def to_pixels(self, points_mm: FloatArray) -> FloatArray:
        """Return the positions (column, row) in pixels of this image for points in mm."""
        pixels = points_mm / [self.spacing_mm[0], -self.spacing_mm[1]]
        return np.asarray(pixels - self.first_pixel)
