"""Frames of a tonometer: greyscale pictures from files, their artefacts, and motion of the eye.

A `Frame` is a greyscale image of a cornea with the size of its pixels. False colours, spots and
text are named when a picture does not show a cornea. The motion of the whole eye between two
frames is determined from the periphery of the cornea.
"""

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
from palpate.workers.organs.cornea.section_outline import RigidMotion, Section


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


# Errors of a segmented surface are correlated over about this length.
CORRELATION_MM = 0.5


@dataclass(frozen=True)
class Registration:
    """The motion of the eye from the undeformed to the deformed frame.

    Parameters
    ----------
    motion : RigidMotion
        Maps the undeformed periphery to the deformed one.
    rms_mm : float
        Remaining distance between the two peripheries, along the normal.
    sd_y_mm, sd_tilt_rad : float
        Standard deviations of shift and tilt, if the remaining distance is noise that is
        correlated over half a millimetre.
    """

    motion: RigidMotion
    rms_mm: float
    sd_y_mm: float
    sd_tilt_rad: float


def register_periphery(
    undeformed: Section, deformed: Section, outer_mm: float = 1.5, shift_x_mm: float = 0.0
) -> Registration:
    """Return the rigid motion of a cornea's periphery between two frames.

    Least squares of the distances along the normal between both surfaces, over the outer part of
    the section on both sides. Shift along y and tilt are fitted; the shift along x is given,
    because a circular arc does not change when rotated about its centre, so x and tilt cannot be
    distinguished. Bending of the periphery by the jet counts as motion: check `rms_mm`, and
    prefer a wide frame and a small `outer_mm`.

    Parameters
    ----------
    undeformed, deformed : Section
        In one coordinate system; both surfaces are functions of x.
    outer_mm : float
        Width of the periphery on each side; > 0.
    shift_x_mm : float
        Shift of the eye along x, of the point midway between the two edges.

    Returns
    -------
    Registration

    Raises
    ------
    InputError
        If the sections do not overlap over three times `outer_mm`.
    """
    ends = [
        (surface[0, 0], surface[-1, 0])
        for section in (undeformed, deformed)
        for surface in (section.anterior_mm, section.posterior_mm)
    ]
    first, last = float(max(e[0] for e in ends)), float(min(e[1] for e in ends))
    if not (outer_mm > 0 and last - first >= 3 * outer_mm):
        raise InputError(
            f"The two frames share {last - first:.2f} mm of the cornea, too little for a periphery "
            f"of {outer_mm} mm on each side. Give a smaller periphery, or two frames of the same "
            "eye."
        )
    middle = 0.5 * (first + last)
    centre = (middle, float(np.interp(middle, *undeformed.anterior_mm.T)))
    y_mm, tilt = 0.0, 0.0
    for _ in range(20):
        motion = RigidMotion((shift_x_mm, y_mm), tilt, centre)
        pairs = [
            _periphery_distances(motion.of_points(a), b, (first, last), outer_mm, centre)
            for a, b in (
                (undeformed.anterior_mm, deformed.anterior_mm),
                (undeformed.posterior_mm, deformed.posterior_mm),
            )
        ]
        residual = np.concatenate([p[0] for p in pairs])
        jacobian = np.concatenate([p[1] for p in pairs])
        step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
        y_mm, tilt = y_mm + float(step[0]), tilt + float(step[1])
        if np.abs(step).max() < 1e-10:
            break
    rms = float(np.sqrt(np.mean(residual**2)))
    independent = max(4 * outer_mm / CORRELATION_MM, 3.0)
    covariance = np.linalg.inv(jacobian.T @ jacobian / len(residual)) * rms**2 / (independent - 2)
    return Registration(
        motion=RigidMotion((shift_x_mm, y_mm), tilt, centre),
        rms_mm=rms,
        sd_y_mm=float(np.sqrt(covariance[0, 0])),
        sd_tilt_rad=float(np.sqrt(covariance[1, 1])),
    )


def _periphery_distances(
    moved: FloatArray,
    target: FloatArray,
    common: tuple[float, float],
    outer: float,
    centre: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Return normal distances of peripheral points, and their derivatives in y and tilt."""
    x = moved[:, 0]
    inside = (x >= common[0]) & (x <= common[1])
    points = moved[inside & ((x < common[0] + outer) | (x > common[1] - outer))]
    slope = np.interp(points[:, 0], target[:, 0], np.gradient(target[:, 1], target[:, 0]))
    cosine = 1 / np.hypot(1, slope)
    gap = points[:, 1] - np.interp(points[:, 0], target[:, 0], target[:, 1])
    # A rotation moves a point by (-(y - yc), x - xc) per radian.
    turn = (points[:, 0] - centre[0]) + slope * (points[:, 1] - centre[1])
    return gap * cosine, np.column_stack([cosine, turn * cosine])
