"""Specks and holes of a segmentation."""

import numpy as np

from storage.values import Tissue, Volume
from workers.images.one_body import one_body


def block() -> np.ndarray:
    values = np.zeros((12, 14, 16), np.uint8)
    values[0:9, 2:12, 2:14] = Tissue.FAT
    values[3:6, 5:9, 5:9] = Tissue.GLANDULAR
    return values


def volume(values: np.ndarray) -> Volume:
    return Volume(values, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))


def test_specks_go_and_holes_become_fat() -> None:
    values = block()
    values[11, 13, 15] = Tissue.GLANDULAR
    values[4, 3, 3] = Tissue.AIR
    np.testing.assert_array_equal(one_body(volume(values)).values, block())


def test_a_dent_and_a_hole_at_the_wall_stay() -> None:
    values = block()
    values[8, 5, 5] = Tissue.AIR
    values[0, 6, 7] = Tissue.AIR
    np.testing.assert_array_equal(one_body(volume(values)).values, values)


def test_a_clean_body_is_not_copied() -> None:
    clean = volume(block())
    assert one_body(clean) is clean
