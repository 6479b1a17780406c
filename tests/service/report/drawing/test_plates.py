"""Positions of plates at a body and in a section."""

import numpy as np
import pytest

from palpate.service.report.drawing.volume_sections import VIEWS, plates_touching
from palpate.storage.values import Volume

FRAME = (-10.0, 10.0, -8.0, 8.0)


def box() -> Volume:
    """Voxels of 1 x 2 x 4 mm; the body fills x 2.5 to 4.5, y 3 to 7, z 2 to 10."""
    values = np.zeros((4, 5, 6), np.uint8)
    values[1:3, 2:4, 3:5] = 1
    return Volume(values, (1.0, 2.0, 4.0), (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("axis", "heights"),
    [((0.0, 1.0, 0.0), (3.0, 7.0)), ((2.0, 0.0, 0.0), (2.5, 4.5)), ((0, 0, 1), (2.0, 10.0))],
)
def test_plates_are_at_the_faces_of_the_outermost_voxels(axis, heights) -> None:
    assert plates_touching(box(), axis).heights_mm == pytest.approx(heights)


def test_lines_cross_the_frame_where_the_plates_are() -> None:
    coronal, transverse, sagittal = VIEWS
    plates = plates_touching(box(), (0.0, 1.0, 0.0))
    for view in (coronal, transverse):
        (low, high) = plates.lines(view, 3.0, FRAME)
        assert low == ((-10.0, 3.0), (10.0, 3.0))
        assert high == ((-10.0, 7.0), (10.0, 7.0))
    assert plates.lines(sagittal, 5.0, FRAME) == []
    assert plates.lines(coronal, 3.0, FRAME, 0.5)[0][0][1] == pytest.approx(2.5)


def test_tilted_plates_satisfy_their_equation() -> None:
    axis = np.array([-0.6, 0.48, 0.64])
    plates = plates_touching(box(), tuple(axis))
    for view in VIEWS:
        for height, line in zip(plates.heights_mm, plates.lines(view, 1.5, FRAME), strict=True):
            for across, up in line:
                point = np.zeros(3)
                point[[view.across, view.up, view.normal]] = across, up, 1.5
                assert point @ axis == pytest.approx(height)
