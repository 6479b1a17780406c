"""Greyscale images of a cornea from files."""

from pathlib import Path

from palpate.workers.organs.cornea.frames.frame import Frame
from palpate.workers.organs.cornea.frames.picture import read_picture


def read_frame(
    path: Path, spacing_mm: tuple[float, float], first_pixel: tuple[float, float] = (0.0, 0.0)
) -> Frame:
    """Return the frame in an image file (PNG, TIFF, JPEG, BMP).

    It is rotated by its EXIF orientation. Colours are averaged and transparency is ignored.

    Parameters
    ----------
    path : Path
    spacing_mm : tuple of float
        Width and height of a pixel of the rotated picture.
    first_pixel : tuple of float
        Column and row of the first pixel in the raster shared by all frames.

    Returns
    -------
    Frame

    Raises
    ------
    InputError
        If the file is missing, not an image, or has several, or `Frame` rejects it.
    """
    grey = read_picture(path)
    if grey.ndim == 3:
        grey = grey.mean(axis=2)
    return Frame(grey=grey, spacing_mm=spacing_mm, first_pixel=first_pixel)
