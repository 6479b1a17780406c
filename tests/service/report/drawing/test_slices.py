"""Sections of volumes small enough to draw."""

from enum import IntEnum

import numpy as np
import pytest

from palpate.service.report.drawing import colours
from palpate.service.report.drawing.colours import DIFFERENCE_PALETTE, TISSUE_PALETTE, Difference
from palpate.service.report.drawing.volume_sections import (
    VIEWS,
    Section,
    difference,
    frame_mm,
    middle_mm,
    section,
)
from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume

CORONAL, TRANSVERSE, SAGITTAL = VIEWS


def drawn(*rows: str, origin: tuple[float, float] = (0.0, 0.0)) -> Section:
    """Return a section from text, top row first; a dot is air, f fat, g gland."""
    labels = {".": Tissue.AIR, "f": Tissue.FAT, "g": Tissue.GLANDULAR}
    values = [[labels[sign] for sign in row] for row in reversed(rows)]
    return Section(np.array(values, np.uint8), (2.0, 1.0), origin)


def one_voxel() -> Volume:
    """4 x 3 x 2 voxels (x, y, z), all air but one at x = 13, y = 22, z = 31."""
    values = np.zeros((2, 3, 4), np.uint8)
    values[1, 2, 3] = Tissue.GLANDULAR
    return Volume(values, (1.0, 1.0, 1.0), (10.0, 20.0, 30.0))


@pytest.mark.parametrize(
    ("view", "at_mm", "shape", "row", "column", "extent"),
    [
        (CORONAL, 31.0, (3, 4), 2, 3, (9.5, 13.5, 19.5, 22.5)),  # up y, across x
        (TRANSVERSE, 13.0, (3, 2), 2, 1, (29.5, 31.5, 19.5, 22.5)),  # up y, across z
        (SAGITTAL, 22.0, (2, 4), 1, 3, (9.5, 13.5, 29.5, 31.5)),  # up z, across x
    ],
)
def test_voxel_position_agrees_with_coordinates(
    view: IntEnum,
    at_mm: float,
    shape: tuple[int, int],
    row: int,
    column: int,
    extent: tuple[float, ...],
) -> None:
    cut = section(one_voxel(), view, at_mm)
    assert cut.values.shape == shape
    assert np.argwhere(cut.values).tolist() == [[row, column]]
    assert cut.extent_mm == extent


@pytest.mark.parametrize(("at_mm", "there"), [(30.4, 0), (30.6, 1), (31.4, 1), (31.6, 0), (9, 0)])
def test_the_nearest_plane_is_cut_and_outside_is_air(at_mm: float, there: int) -> None:
    assert np.count_nonzero(section(one_voxel(), CORONAL, at_mm).values) == there


def test_middle_of_a_tissue_in_mm() -> None:
    assert middle_mm(one_voxel(), [Tissue.GLANDULAR]) == (13.0, 22.0, 31.0)
    assert middle_mm(one_voxel(), [Tissue.SKIN]) == (13.0, 22.0, 31.0)  # not there: the body's
    values = np.zeros((1, 1, 4), np.uint8)
    values[0, 0, [0, 1, 3]] = Tissue.FAT  # at x = 0, 2 and 6
    assert middle_mm(Volume(values, (2.0, 1.0, 1.0)), [Tissue.FAT]) == (8 / 3, 0.0, 0.0)


def test_air_has_no_middle() -> None:
    with pytest.raises(InputError, match="only air"):
        middle_mm(Volume(np.zeros((2, 2, 2), np.uint8), (1.0, 1.0, 1.0)), [Tissue.FAT])


def test_difference_in_boxes_that_differ_matches_hand_calculation() -> None:
    target = drawn(".ff.", "fggf", ".gf.")
    # Two mm to the right (one column) and one mm up (one row) of the target's box.
    best = drawn(".f.", "gg.", "ffg", origin=(2.0, 1.0))
    told = difference(target, best, [Tissue.GLANDULAR])
    B, T, C, o = Difference.BOTH, Difference.ONLY_TARGET, Difference.ONLY_BEST, Difference.BODY
    expected = [  # from the top; columns begin at the target's first
        [0, 0, o, 0],
        [0, C, C, 0],
        [o, T, T, C],
        [0, T, o, 0],
    ]
    assert told.values[::-1].tolist() == expected
    assert told.origin_mm == (0.0, 0.0)
    assert B not in told.values
    same = difference(target, target, [Tissue.GLANDULAR])
    assert np.count_nonzero(same.values == B) == 3
    assert not np.isin(same.values, [T, C]).any()


def test_frame_contains_bodies_tightly() -> None:
    roomy = drawn("....", ".f..", "....")  # x from 1 to 3, y from 0.5 to 1.5
    left, right, bottom, top = frame_mm([roomy])
    assert (left, right, bottom, top) == pytest.approx((1 - 0.08, 3 + 0.08, 0.5 - 0.08, 1.5 + 0.08))
    moved = Section(roomy.values, roomy.spacing_mm, (10.0, 0.0))
    assert frame_mm([roomy, moved])[1] > 13.0


def _lightness(colour: str) -> float:
    """Return CIE L* of an sRGB colour."""
    rgb = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = float(linear @ [0.2126, 0.7152, 0.0722])
    return 116 * y ** (1 / 3) - 16 if y > 0.008856 else 903.3 * y


def test_colours_that_lie_side_by_side_differ_in_lightness() -> None:
    only = [DIFFERENCE_PALETTE[Difference.ONLY_TARGET], DIFFERENCE_PALETTE[Difference.ONLY_BEST]]
    assert abs(_lightness(only[0]) - _lightness(only[1])) > 20
    gland = _lightness(TISSUE_PALETTE[Tissue.GLANDULAR])
    for other in (Tissue.AIR, Tissue.FAT, Tissue.LIGAMENT):
        assert abs(_lightness(TISSUE_PALETTE[other]) - gland) > 20


def test_an_unknown_label_is_drawn_in_black() -> None:
    table = colours.colour_table(TISSUE_PALETTE)
    assert table[200].tolist() == [0, 0, 0, 255]
    assert table[Tissue.AIR].tolist() == [255, 255, 255, 0]
