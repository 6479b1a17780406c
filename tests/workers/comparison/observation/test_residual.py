"""Residuals of ellipsoids shifted by a known amount."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    interface_points,
    observe,
    residual,
)
from tests.workers.comparison.observation.ellipsoids import breast

BOTH = (OUTLINE, GLANDULAR)
SHIFT = np.array([0.83, -0.46, 0.61])


@pytest.fixture(scope="module")
def points():
    return interface_points(breast(), BOTH, 1.5, 2.0)


@pytest.fixture(scope="module")
def shifted():
    return observe(breast(shift=SHIFT), BOTH)


def test_reference_has_no_residual_against_itself(points):
    r, normals = residual(points.points, points, observe(breast(), BOTH))
    assert abs(r.mean()) < 1e-3 and r.std() < 5e-3
    assert np.sum(normals * points.normals, axis=1) == pytest.approx(1, abs=0.05)


def test_shift_is_observed_along_the_normal(points, shifted):
    # Points that the model leaves in place are outside the body where it moved away from them.
    r, _ = residual(points.points, points, shifted)
    expected = -points.normals @ SHIFT
    # To second order, a shift of 1.1 mm along a surface of radius >= 4.5 mm adds 0.14 mm.
    assert np.abs(r - expected).mean() < 0.06
    assert np.corrcoef(r, expected)[0, 1] > 0.99
    moved, _ = residual(points.points + SHIFT, points, shifted)
    assert abs(moved.mean()) < 0.01
    assert np.abs(moved).mean() < 0.05 * 0.5 * 2  # 0.05 voxel in each scan


def test_points_outside_have_positive_residuals(points, shifted):
    for step in (0.7, -0.7):
        r, _ = residual(points.points + SHIFT + step * points.normals, points, shifted)
        assert r.mean() == pytest.approx(step, abs=0.02) and r.std() < 0.05


def test_normal_is_the_derivative_of_the_residual(points, shifted):
    where = points.points + 0.8 * SHIFT
    _, normals = residual(where, points, shifted)
    change = 1e-5 * np.random.default_rng(5).standard_normal(where.shape)
    difference = residual(where + change, points, shifted)[0]
    difference = difference - residual(where - change, points, shifted)[0]
    np.testing.assert_allclose(difference, 2 * np.sum(normals * change, axis=1), atol=1e-8)


def test_refuses_mismatched_points_and_interfaces(points, shifted):
    with pytest.raises(InputError, match="Expected the positions"):
        residual(points.points[:-1], points, shifted)
    alone = replace(shifted, distances=shifted.distances[:1])
    with pytest.raises(InputError, match="only 1 were observed"):
        residual(points.points, points, alone)
