"""A section from an image file: read, segmented, corrected for refraction."""

from pathlib import Path

from workers.organs.cornea.frame_reading import read_frame
from workers.organs.cornea.frame_segmentation import segment_frame
from workers.organs.cornea.refraction import corrected_posterior
from workers.organs.cornea.section import Section
from workers.organs.cornea.section_checks import check_section
from workers.organs.cornea.spec import FrameSpec


def imaged_section(spec: FrameSpec) -> Section:
    """Return the section in an image, in the coordinates of the frame (x from its left edge).

    Raises
    ------
    InputError
        If the file is no image, no cornea is seen in it, or its surfaces cross.
    """
    segmented = segment_frame(read_frame(Path(spec.file), spec.pixel_mm, spec.first_pixel))
    anterior, posterior = segmented.anterior_mm, segmented.posterior_mm
    if spec.refraction is not None:
        posterior = corrected_posterior(
            anterior, posterior, spec.refraction.index, spec.refraction.camera_angle_deg
        )
    section = Section(anterior_mm=anterior, posterior_mm=posterior)
    check_section(section)
    return section
