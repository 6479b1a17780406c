"""Removal of specks and holes of a segmentation."""

import numpy as np
from scipy.ndimage import binary_fill_holes, label

from palpate.storage.values import Tissue, Volume
from palpate.workers.organs.breast.scan_facts import AIR_VOXELS, in_air, one_body


def block() -> np.ndarray:
    values = np.zeros((12, 14, 16), np.uint8)
    values[0:9, 2:12, 2:14] = Tissue.FAT
    values[3:6, 5:9, 5:9] = Tissue.GLANDULAR
    return values


def volume(values: np.ndarray) -> Volume:
    return Volume(values, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))


def test_specks_are_removed_and_holes_become_fat() -> None:
    values = block()
    values[11, 13, 15] = Tissue.GLANDULAR
    values[4, 3, 3] = Tissue.AIR
    np.testing.assert_array_equal(one_body(volume(values)).values, block())


def test_dent_and_hole_at_the_wall_are_kept() -> None:
    values = block()
    values[8, 5, 5] = Tissue.AIR
    values[0, 6, 7] = Tissue.AIR
    np.testing.assert_array_equal(one_body(volume(values)).values, values)


def test_fills_exactly_the_enclosed_air() -> None:
    """Random crumbs, including holes that are open only at an edge or a corner."""
    values = block()
    values[np.random.default_rng(7).random(values.shape) < 0.3] = Tissue.AIR
    after = one_body(volume(values)).values != Tissue.AIR
    np.testing.assert_array_equal(after, binary_fill_holes(after))
    pieces, _ = label(values != Tissue.AIR)
    largest = pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:])
    np.testing.assert_array_equal(after, binary_fill_holes(largest))
    assert np.count_nonzero(after) > np.count_nonzero(largest)


def test_clean_body_is_not_copied() -> None:
    clean = volume(block())
    assert one_body(clean) is clean


def test_added_air_moves_no_voxel() -> None:
    """Voxels are longer along y than along x, and the body touches four faces of its box."""
    values = block()[:, 2:12, 2:14]
    before = Volume(values, (0.5, 1.25, 2.0), (-3.0, 4.0, 10.0))
    after = in_air(before)
    nx, ny, nz = before.shape_xyz
    assert after.shape_xyz == (nx + 2 * AIR_VOXELS, ny + 2 * AIR_VOXELS, 9 + AIR_VOXELS)
    assert after.origin_mm == (-3.0 - AIR_VOXELS * 0.5, 4.0 - AIR_VOXELS * 1.25, 10.0)
    z, y, x = np.nonzero(after.values)
    places = np.column_stack([x, y, z]) * after.spacing_mm + np.array(after.origin_mm)
    i, j, k = np.rint((places - before.origin_mm) / before.spacing_mm).astype(int).T
    np.testing.assert_array_equal(after.values[z, y, x], before.values[k, j, i])
    assert len(z) == np.count_nonzero(before.values)
    assert after.values[0].any() and nz > 9  # no air below the wall; air above is cropped
