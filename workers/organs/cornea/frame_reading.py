"""Grey images of a cornea from files."""

from pathlib import Path

import numpy as np
from PIL import Image

from storage.errors import InputError
from workers.organs.cornea.frame import Frame


def read_frame(
    path: Path, spacing_mm: tuple[float, float], first_pixel: tuple[float, float] = (0.0, 0.0)
) -> Frame:
    """Return the frame in an image file (PNG, TIFF, JPEG, BMP).

    Colours are averaged and transparency is left out.

    Parameters
    ----------
    path : Path
    spacing_mm : tuple of float
        Width and height of a pixel.
    first_pixel : tuple of float
        Column and row of the first pixel in the raster that all frames share.

    Returns
    -------
    Frame

    Raises
    ------
    InputError
        If the file is missing or not an image, or `Frame` refuses it.
    """
    if not path.is_file():
        raise InputError(f"There is no image {path}. Give the path of a frame of the cornea.")
    try:
        with Image.open(path) as image:
            coloured = image.mode not in ("L", "1", "F") and not image.mode.startswith("I")
            grey = np.asarray(image.convert("RGB") if coloured else image, dtype=np.float64)
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(
            f"{path} is not an image that can be read ({error}). Give a PNG, TIFF, JPEG or BMP."
        ) from error
    if grey.ndim == 3:
        grey = grey.mean(axis=2)
    return Frame(grey=grey, spacing_mm=spacing_mm, first_pixel=first_pixel)
