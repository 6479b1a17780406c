"""Whole-number distance maps, compared with scipy, and their weights."""

import numpy as np
import pytest
from scipy.ndimage import binary_erosion, distance_transform_edt

from palpate.storage.errors import InputError
from palpate.workers.comparison.voxel_set import BOUNDARY, INTERIOR, Metric, distance_map, voxel_set
from tests.workers.comparison.drawings import of_mask


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 0.25, 2.0), (0.3, 0.41, 0.77)])
@pytest.mark.parametrize("density", [0.0005, 0.02, 0.5, 0.95])
@pytest.mark.parametrize("least_class", [INTERIOR, BOUNDARY])
def test_map_matches_scipy(spacing, density, least_class):
    rng = np.random.default_rng(3)
    mask = rng.random((19, 35, 23)) < density
    mask[4, 30, 11] = True
    volume = of_mask(mask, spacing)
    voxels = voxel_set(volume, (2,), volume)
    metric = Metric.of_spacing(spacing)
    # The box is larger than the image on every side.
    distances = distance_map(voxels, least_class, metric, (-2, -3, -4), (20, 36, 27))
    padded = np.pad(mask, ((2, 1), (3, 1), (4, 4)))
    features = padded & ~binary_erosion(padded) if least_class == BOUNDARY else padded
    expected = distance_transform_edt(~features, sampling=spacing[::-1])
    np.testing.assert_allclose(np.sqrt(distances.squared) * metric.unit_mm, expected, rtol=1e-7)
    assert distances.start == (-2, -3, -4)


def test_isotropic_map_counts_squared_voxels():
    """The map of a single voxel is dz^2 + dy^2 + dx^2, to the last digit."""
    mask = np.zeros((1, 1, 1), bool)
    mask[0, 0, 0] = True
    volume = of_mask(mask, (0.2, 0.2, 0.2))
    voxels = voxel_set(volume, (2,), volume)
    distances = distance_map(
        voxels, BOUNDARY, Metric.of_spacing(volume.spacing_mm), (-3, 0, -40), (5, 9, 7)
    )
    z, y, x = np.ogrid[-3:5, 0:9, -40:7]
    np.testing.assert_array_equal(distances.squared, z**2 + y**2 + x**2)
    assert distances.squared.dtype == np.int32


def test_boundary_voxels_match_the_drawing():
    """In the middle plane of a 5 x 4 x 3 block only the voxels marked 1 are interior.

    ::

        2 2 2 2 2
        2 1 1 1 2
        2 1 1 1 2
        2 2 2 2 2
    """
    mask = np.zeros((5, 6, 7), bool)
    mask[1:4, 1:5, 1:6] = True
    volume = of_mask(mask)
    voxels = voxel_set(volume, (2,), volume)
    assert voxels.start == (1, 1, 1)
    assert voxels.stop == (4, 5, 6)
    assert (voxels.count, voxels.boundary_count) == (60, 54)
    middle = [[2, 2, 2, 2, 2], [2, 1, 1, 1, 2], [2, 1, 1, 1, 2], [2, 2, 2, 2, 2]]
    np.testing.assert_array_equal(voxels.mask[1], middle)
    assert np.all(voxels.mask[[0, 2]] == BOUNDARY)


@pytest.mark.parametrize(
    ("spacing", "weights", "unit_mm"),
    [
        ((0.2, 0.2, 0.2), (1, 1, 1), 0.2),
        ((0.2, 0.2, 0.5), (25, 4, 4), 0.1),  # (0.5 / 0.2)^2 = 25 / 4
        ((1.0, 2.0, 3.0), (9, 4, 1), 1.0),
    ],
)
def test_weights_of_common_spacings_are_small_and_exact(spacing, weights, unit_mm):
    metric = Metric.of_spacing(spacing)
    assert metric.weights == weights
    assert metric.unit_mm == pytest.approx(unit_mm)


@pytest.mark.parametrize("spacing", [(0.3, 0.41, 0.777), (0.0332, 3.1, 17.0)])
def test_weights_of_other_spacings_are_accurate(spacing):
    metric = Metric.of_spacing(spacing)
    np.testing.assert_allclose(np.sqrt(metric.weights) * metric.unit_mm, spacing[::-1], rtol=1e-6)


def test_refuses_numbers_beyond_64_bits():
    volume = of_mask(np.ones((1, 1, 1), bool), (1.0, 1.0, 1.0))
    voxels = voxel_set(volume, (2,), volume)
    with pytest.raises(InputError, match="64-bit"):
        distance_map(voxels, BOUNDARY, Metric((2**60, 1, 1), 1.0), (0, 0, 0), (3, 1, 1))
