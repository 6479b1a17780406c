"""Noise of the scans: each scan's own noise, and the noise of the scan at rest in all scans."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise, correlation
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.problem.inverse_problem import FollowedPoints
from palpate.workers.diagnosis.problem.scan_noise import planned_covariance, stated_covariance
from tests.workers.diagnosis.fits.test_gauss_newton import problem_between_plates

NOISE = SegmentationNoise(0.1, 4.0, 0.06, 0.01)


@pytest.fixture(scope="module")
def inverse():
    """Return two scans; in the second, a plate presses half of the points flat."""
    plain = replace(problem_between_plates(), noise=NOISE)
    k = len(plain.points)
    pressed = np.where(np.arange(k) < k // 2, 1.0, 0.0)
    flat = FollowedPoints(plain.points.points, plain.at_points, pressed)
    first, second = plain.scans
    return replace(plain, scans=[first, replace(second, followed=flat)])


def drawn(inverse, sd_mm):
    """Return the covariance of one drawing, with its smoother part."""
    settings, length = SETTINGS.noise, NOISE.correlation_mm
    smoother = settings.smoother**2 * correlation(
        inverse.points, settings.smoother_lengths * length
    )
    return sd_mm**2 * (correlation(inverse.points, length) + smoother)


def test_unpressed_points_share_the_error_at_rest(inverse):
    k = len(inverse.points)
    found = stated_covariance(inverse).reshape(2, k, 2, k)
    at_rest, own = (drawn(inverse, sd) for sd in (NOISE.reference_sd_mm, NOISE.sd_mm))
    free = np.arange(k) >= k // 2
    nugget = NOISE.nugget_mm**2 * np.eye(k)
    np.testing.assert_allclose(found[0, :, 0], at_rest + own + nugget, atol=1e-12)
    np.testing.assert_allclose(found[0, :, 1], at_rest * free, atol=1e-12)
    pressed = at_rest * np.outer(free, free)
    np.testing.assert_allclose(found[1, :, 1], pressed + own + nugget, atol=1e-12)


def test_planned_noise_equals_the_noise_without_pressed_points(inverse):
    """It also includes poses and contour bias."""
    k = len(inverse.points)
    planned = planned_covariance(inverse)
    stated = stated_covariance(replace(inverse, scans=[inverse.scans[0]] * 2))
    assert planned.shape == (2 * k, 2 * k)
    assert np.linalg.eigvalsh(planned - stated).min() > -1e-9
