"""A section from an image file: read, segmented and corrected for refraction."""

from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.frames.frame import Frame
from palpate.workers.organs.cornea.frames.picture import likely_causes, read_picture
from palpate.workers.organs.cornea.frames.reading import read_frame
from palpate.workers.organs.cornea.frames.segmentation import segment_frame
from palpate.workers.organs.cornea.plausible import PRESSED_CENTRAL_MM, WIDTH_MM
from palpate.workers.organs.cornea.section.checks import check_section
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.section.refraction import corrected_posterior
from palpate.workers.organs.cornea.section.shape import shape_of
from palpate.workers.organs.cornea.spec import FrameSpec

# Scales that are tried on a picture in which no cornea is found.
EXPORTED = (2, 3, 4)


def imaged_section(spec: FrameSpec) -> Section:
    """Return the section in an image, in the coordinates of the frame (x from its left edge).

    Raises
    ------
    InputError
        If the file is not an image, no cornea is found in it, or its surfaces cross; with the
        file's name and likely causes in the picture.
    """
    path = Path(spec.file)
    frame = read_frame(path, spec.pixel_mm, spec.first_pixel)
    try:
        section = _section(frame, spec)
        check_section(section)
    except InputError as error:
        causes = likely_causes(read_picture(path)) + _remedy(frame, spec)
        raise InputError(f"{path}: {error}{causes}") from error
    return section


def _section(frame: Frame, spec: FrameSpec) -> Section:
    segmented = segment_frame(frame)
    anterior, posterior = segmented.anterior_mm, segmented.posterior_mm
    if spec.refraction is not None:
        posterior = corrected_posterior(
            anterior, posterior, spec.refraction.index, spec.refraction.camera_angle_deg
        )
    return Section(anterior_mm=anterior, posterior_mm=posterior)


def _remedy(frame: Frame, spec: FrameSpec) -> str:
    """Return advice if a cornea is found in the rotated picture, or with smaller pixels."""
    across, down = frame.spacing_mm
    if _shows_cornea(Frame(np.rot90(frame.grey), (down, across)), spec):
        return " A cornea is found if the picture is rotated by 90 degrees: rotate the file."
    for times in EXPORTED:
        size = (across / times, down / times)
        if _shows_cornea(Frame(frame.grey, size), spec):
            return (
                f" A cornea is found if the picture was exported at {times} times its size: set "
                f"pixel_mm to [{size[0]:.6g}, {size[1]:.6g}], or give the original picture."
            )
    return ""


def _shows_cornea(frame: Frame, spec: FrameSpec) -> bool:
    try:
        shape = shape_of(_section(frame, spec))
    except InputError:
        return False
    return shape.central_thickness_mm in PRESSED_CENTRAL_MM and shape.width_mm in WIDTH_MM
