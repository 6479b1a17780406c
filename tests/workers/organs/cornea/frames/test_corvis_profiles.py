"""The real pair of Corvis frames: reading, segmentation, registration and meshing."""

from pathlib import Path

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.frame_segmentation import segment_frame
from palpate.workers.organs.cornea.section_mesh import mesh_section, t6_quality
from palpate.workers.organs.cornea.section_outline import Section, corrected_posterior
from palpate.workers.organs.cornea.tonometer_frames import read_frame, register_periphery
from tests.workers.organs.cornea.frames.corvis_profiles import (
    CorvisPair,
    chord_motion,
    read_corvis_pair,
)

REPOSITORY = Path(__file__).parents[5]
FOLDERS = [parent / "shared/data/corvis_profiles" for parent in REPOSITORY.parents]
FOLDER = next((folder for folder in FOLDERS if folder.is_dir()), FOLDERS[0])
needs_data = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="the corvis_profiles data set is not next to the repository"
)


@pytest.fixture(scope="module")
def pair() -> CorvisPair:
    return read_corvis_pair(FOLDER)


@needs_data
def test_both_surfaces_follow_the_published_contours(pair: CorvisPair) -> None:
    for frame, contours in (
        (pair.undeformed, pair.undeformed_contours_mm),
        (pair.deformed, pair.deformed_contours_mm),
    ):
        found = segment_frame(frame)
        assert len(found.columns) == frame.grey.shape[1]
        for surface, contour, offset_px in (
            (found.anterior_mm, contours[0], 4.2),
            (found.posterior_mm, contours[1], -1.9),
        ):
            below = np.interp(surface[:, 0], *contour.T) - surface[:, 1]
            below_px = below / frame.spacing_mm[1]
            # The published edge is where the grey value passes 22, in the skirt of the bright
            # band outside its steepest position: a nearly constant offset.
            assert below_px.mean() == pytest.approx(offset_px, abs=0.8)
            assert below_px.std() < 1.5


@needs_data
def test_published_contours_have_the_stated_grey_value(pair: CorvisPair) -> None:
    # The scale, the shift between the frames and the direction of y are correct if the image has
    # a grey value of 22 on the published anterior contour.
    for frame, contours in (
        (pair.undeformed, pair.undeformed_contours_mm),
        (pair.deformed, pair.deformed_contours_mm),
    ):
        column, row = np.rint(frame.to_pixels(contours[0])).astype(int).T
        assert abs(np.median(frame.grey[row, np.clip(column, 0, None)]) - 22) < 5


@needs_data
def test_registers_and_meshes_the_pair(pair: CorvisPair) -> None:
    undeformed, deformed = segment_frame(pair.undeformed), segment_frame(pair.deformed)
    registration = register_periphery(undeformed.section, deformed.section, outer_mm=1.0)
    # Published displacements of the outermost columns: 0.36 mm left and 0.15 mm right.
    assert registration.motion.shift_mm[1] == pytest.approx(-0.25, abs=0.03)
    assert registration.motion.tilt_rad == pytest.approx((0.36 - 0.15) / 9.0, abs=0.008)
    assert registration.rms_mm < 0.012
    posterior = corrected_posterior(undeformed.anterior_mm, undeformed.posterior_mm)
    section = Section(undeformed.anterior_mm, posterior)
    level = chord_motion(section).of_section(section)
    middle = np.interp(0.0, *level.anterior_mm.T) - np.interp(0.0, *level.posterior_mm.T)
    assert 0.40 < middle < 0.60
    quality = t6_quality(mesh_section(level, 960, (-1.5, 1.5)))
    assert quality.smallest_jacobian > 0.8
    assert quality.mean_shape > 0.75


def test_rejects_missing_or_invalid_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"lacks README\.md"):
        read_corvis_pair(tmp_path)
    with pytest.raises(InputError, match="There is no image"):
        read_frame(tmp_path / "frame.png", (0.01, 0.01))
    (tmp_path / "frame.png").write_text("not an image")
    with pytest.raises(InputError, match="not an image that can be read"):
        read_frame(tmp_path / "frame.png", (0.01, 0.01))
