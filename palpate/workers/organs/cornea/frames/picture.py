"""Pictures of a cornea read from files, and detection of artefacts in them."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from scipy.ndimage import find_objects, label
from skimage.filters import threshold_otsu

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.input_files import check_regular, reason_of

MOST_PIXELS = 25_000_000
# Difference of the channels, relative to full brightness, from which a pixel counts as coloured.
COLOURED_FROM = 0.18
# Fewer coloured pixels, absolutely and as a fraction of the picture, are compression artefacts.
FEWEST_COLOURED = 20
LEAST_COLOURED_PART = 1e-4
# From this fraction on the whole picture counts as coloured.
FALSE_COLOURS_FROM = 0.2
# Smallest bright spot, as a fraction of the picture, and smallest bright edge, in columns.
LEAST_SPOT_PART = 5e-4
FULL_BRIGHTNESS = 0.98
LEAST_EDGE_PART = 0.05


@dataclass(frozen=True)
class Box:
    """A part of a picture, including its first and last pixels."""

    columns: tuple[int, int]
    rows: tuple[int, int]

    def __str__(self) -> str:
        (left, right), (top, bottom) = self.columns, self.rows
        return f"columns {left} to {right}, rows {top} to {bottom}"


def read_picture(path: Path) -> FloatArray:
    """Return the picture in a file (PNG, TIFF, JPEG, BMP), rotated by its EXIF orientation.

    Transparency is ignored.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ndarray, shape (rows, columns) or (rows, columns, 3)

    Raises
    ------
    InputError
        If the file is missing, is not an image, or has several.
    """
    if not path.is_file():
        raise InputError(f"There is no image {path}. Give the path of a frame of the cornea.")
    check_regular(path)
    try:
        with warnings.catch_warnings(), Image.open(path) as image:
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            if image.width * image.height > MOST_PIXELS:
                raise InputError(
                    f"{path} has {image.width} x {image.height} pixels, more than a frame of a "
                    f"cornea can have ({MOST_PIXELS:,}). Give the frame as the camera saved it."
                )
            count = getattr(image, "n_frames", 1)
            upright = ImageOps.exif_transpose(image)
            coloured = upright.mode not in ("L", "1", "F") and not upright.mode.startswith("I")
            values = np.asarray(upright.convert("RGB") if coloured else upright, np.float64)
    except InputError:
        raise
    except Exception as error:  # Pillow raises nearly anything on damaged pictures
        raise InputError(
            f"{path} is not an image that can be read ({reason_of(error)}). "
            "Give a PNG, TIFF, JPEG or BMP."
        ) from error
    if count > 1:
        raise InputError(
            f"{path} has {count} images; expected one. Save the frame before the puff and the "
            "frame during it as separate files."
        )
    return values


def coloured_pixels(picture: FloatArray) -> NDArray[np.bool_]:
    """Return a mask of the pixels with a colour that the other pixels do not have.

    A uniformly tinted picture has none.

    Parameters
    ----------
    picture : ndarray, shape (rows, columns) or (rows, columns, 3)
    """
    if picture.ndim == 2:
        return np.zeros(picture.shape, np.bool_)
    grey = picture.mean(axis=2)
    bright = grey >= np.median(grey)
    tint = np.median(picture[bright], axis=0) / max(float(np.median(grey[bright])), 1.0)
    found = np.ptp(picture - grey[:, :, None] * tint, axis=2) > COLOURED_FROM * full_scale(picture)
    few = found.sum() < max(FEWEST_COLOURED, LEAST_COLOURED_PART * found.size)
    return np.zeros_like(found) if few else found


def full_scale(picture: FloatArray) -> float:
    """Return the grey value of white: 255, or the largest value if that is larger."""
    return max(255.0, float(picture.max()))


def box_of(mask: NDArray[np.bool_]) -> Box:
    """Return the bounding box of a mask that is not empty."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return Box((int(columns[0]), int(columns[-1])), (int(rows[0]), int(rows[-1])))


def likely_causes(picture: FloatArray) -> str:
    """Return the parts of a picture that may have been mistaken for a cornea, or an empty text.

    The text is the end of a message and starts with a space.
    """
    found = [*_colours(picture), *_spots(picture), *_top(picture)]
    return f" Found in the picture: {'; '.join(found)}." if found else ""


def _colours(picture: FloatArray) -> Iterator[str]:
    coloured = coloured_pixels(picture)
    count = int(coloured.sum())
    if count > FALSE_COLOURS_FROM * coloured.size:
        yield "false colours; export it in grey"
    elif count:
        yield f"{count:,} coloured pixels, such as a viewer's lines or text ({box_of(coloured)})"


def _spots(picture: FloatArray) -> Iterator[str]:
    grey = picture if picture.ndim == 2 else picture.mean(axis=2)
    numbers, count = label(grey >= FULL_BRIGHTNESS * full_scale(picture))
    sizes = np.bincount(numbers.ravel(), minlength=count + 1)[1:]
    if not count or sizes.max() < LEAST_SPOT_PART * grey.size:
        return
    where = find_objects(numbers)[int(sizes.argmax())]
    box = Box((where[1].start, where[1].stop - 1), (where[0].start, where[0].stop - 1))
    yield f"pixels at full brightness, such as a reflection or text ({box})"


def _top(picture: FloatArray) -> Iterator[str]:
    grey = picture if picture.ndim == 2 else picture.mean(axis=2)
    if np.ptp(grey) == 0:
        return
    numbers, _ = label(grey > threshold_otsu(grey))
    first = np.flatnonzero(numbers[0])
    if len(first) >= LEAST_EDGE_PART * grey.shape[1]:
        box = box_of(np.isin(numbers, np.unique(numbers[0][first])))
        yield f"a bright part from the first row on, such as a lid or a window's frame ({box})"
