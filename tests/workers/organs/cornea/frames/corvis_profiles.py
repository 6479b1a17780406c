"""The open set of Corvis ST profiles: a pair of frames with their contours."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section_outline import RigidMotion, Section
from palpate.workers.organs.cornea.tonometer_frames import Frame, read_frame


def chord_motion(section: Section) -> RigidMotion:
    """Return the motion that places the chord of the anterior surface on the x axis, centred.

    Parameters
    ----------
    section : Section
        Undeformed.

    Returns
    -------
    RigidMotion
    """
    left, right = section.anterior_mm[0], section.anterior_mm[-1]
    middle = 0.5 * (left + right)
    return RigidMotion(
        shift_mm=(-float(middle[0]), -float(middle[1])),
        tilt_rad=-float(np.arctan2(right[1] - left[1], right[0] - left[0])),
        centre_mm=(float(middle[0]), float(middle[1])),
    )


README = "README.md"
IMAGES = ("pair_rest_0.00ms.png", "pair_deformed_18.27ms.png")
CONTOURS = ("pair_contours_rest.csv", "pair_contours_18.27ms.csv")
NUMBER = r"([+-]?\d+(?:\.\d+)?)"


@dataclass(frozen=True, eq=False)
class CorvisPair:
    """Two frames of one eye before and under the air puff, in one coordinate system.

    Parameters
    ----------
    undeformed, deformed : Frame
    undeformed_contours_mm, deformed_contours_mm : tuple of ndarray
        Anterior and posterior edges from the data set, shape (k, 2) each, in the coordinates of
        the frames, not corrected for refraction.
    """

    undeformed: Frame
    deformed: Frame
    undeformed_contours_mm: tuple[FloatArray, FloatArray]
    deformed_contours_mm: tuple[FloatArray, FloatArray]


def read_corvis_pair(folder: Path) -> CorvisPair:
    """Return the pair of frames of the set, with the scale given in its README.

    The images are screenshots of a camera raster of 576 columns; one magnification, from
    their mean width, applies to both. The README gives the pixel size of the camera and
    the shift between the two screenshots.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    CorvisPair

    Raises
    ------
    InputError
        If a file is missing, or the README does not state scale and shift in the known form.
    """
    for name in (README, *IMAGES, *CONTOURS):
        if not (folder / name).is_file():
            raise InputError(
                f"{folder} lacks {name}. Give the folder of the corvis_profiles data set."
            )
    readme = (folder / README).read_text(encoding="utf-8")
    (width_mm,) = _stated(rf"{NUMBER} mm/px in x", readme)
    (height_mm,) = _stated(rf"{NUMBER} mm/px in y", readme)
    (columns,) = _stated(rf"for {NUMBER} px", readme)
    shift = _stated(rf"shift \({NUMBER}, {NUMBER}\) px", readme)
    camera_mm = (width_mm, height_mm)
    undeformed, deformed = (read_frame(folder / name, camera_mm) for name in IMAGES)
    magnification = (undeformed.grey.shape[1] + deformed.grey.shape[1]) / 2 / columns
    spacing = (width_mm / magnification, height_mm / magnification)
    return CorvisPair(
        undeformed=Frame(undeformed.grey, spacing),
        deformed=Frame(deformed.grey, spacing, (shift[0], shift[1])),
        undeformed_contours_mm=_contours(folder / CONTOURS[0]),
        deformed_contours_mm=_contours(folder / CONTOURS[1]),
    )


def _stated(pattern: str, readme: str) -> tuple[float, ...]:
    match = re.search(pattern, readme)
    if match is None:
        raise InputError(
            f"The README of the Corvis profiles does not state {pattern!r}. Give the two images "
            "with their pixel size as separate frames instead."
        )
    return tuple(float(number) for number in match.groups())


def _contours(path: Path) -> tuple[FloatArray, FloatArray]:
    x, anterior, posterior = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    return np.column_stack([x, -anterior]), np.column_stack([x, -posterior])
