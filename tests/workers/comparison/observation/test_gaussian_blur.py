"""The blur of voxels equals scipy's, up to single-precision rounding."""

import numpy as np
import pytest
from scipy import ndimage

from palpate.workers.comparison.observation.isosurface import PIECE, blurred, half_kernel


@pytest.mark.parametrize("sigma", [(1.5, 1.5, 1.5), (0.4, 3.0, 1.1), (6.0, 0.7, 8.0)])
@pytest.mark.parametrize("shape", [(9, 7, 11), (1, 3, 40), (2, 70, PIECE // 30)])
def test_blur_equals_scipy(sigma, shape):
    """The cases include Gaussians wider than the volume, and lines cut into pieces."""
    values = np.random.default_rng(1).random(shape).astype(np.float32)
    expected = ndimage.gaussian_filter(values.astype(float), sigma, mode="nearest", truncate=3.5)
    np.testing.assert_allclose(blurred(values, sigma, 3.5), expected, atol=2e-6)


def test_weights_sum_to_one():
    weights = half_kernel(2.3, 4.0).astype(float)
    assert len(weights) == 10
    assert weights[0] + 2 * weights[1:].sum() == pytest.approx(1.0, abs=1e-6)


def test_input_is_unchanged():
    values = np.ones((4, 5, 6), np.float32)
    values[2, 2, 2] = 0.0
    before = values.copy()
    assert blurred(values, (1.0, 1.0, 1.0), 3.0).min() > 0.0
    assert (values == before).all()
