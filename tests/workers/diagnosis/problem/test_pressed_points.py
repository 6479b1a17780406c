"""Points pressed by a plate are on it wherever they were drawn; others are unaffected."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.workers.comparison.observation.segmentation_noise import covariance
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.diagnosis.problem.scan_noise import pressed_shares, with_pressed_points
from palpate.workers.diagnosis.problem.scan_prediction import derivatives, predict_scan
from tests.workers.diagnosis.fits.test_gauss_newton import FREE, problem_between_plates

DRAWN_SD_MM = 0.3


@pytest.fixture(scope="module")
def drawn():
    """Return a body with segmentation errors, its solutions and pressed shares for two loads."""
    inverse = problem_between_plates()
    on = inverse.points
    errors = DRAWN_SD_MM * np.random.default_rng(2).standard_normal(len(on))
    points = replace(on, points=on.points + errors[:, None] * on.normals)
    inverse = replace(inverse, points=points)
    free = unknowns(FREE, [])
    solved = [predict_scan(inverse, scan, free, free.mean, None) for scan in inverse.scans]
    shares = [pressed_shares(inverse, inverse.forward.pressed(one.at)) for one in solved]
    return inverse, solved, shares


def test_pressed_points_are_on_the_plate(drawn):
    inverse, solved, shares = drawn
    flat = with_pressed_points(inverse, shares)
    for scan, one, share in zip(flat.scans, solved, shares, strict=True):
        u, axis = one.at.solution.displacement_mm, flat.directions[0]
        before, after = one.points @ axis, flat.followed(scan).moved(u) @ axis
        on_upper = (share > 0.999) & (flat.points.normals @ axis > 0)
        assert on_upper.sum() >= 5
        # The penalty lets faces penetrate the plate by less than a tenth of a millimetre.
        assert np.ptp(after[on_upper]) < 0.1
        assert np.ptp(before[on_upper]) > 2 * DRAWN_SD_MM
        np.testing.assert_array_equal(after[share == 0], before[share == 0])


def test_a_larger_load_presses_more_points(drawn):
    _, _, (less, more) = drawn
    assert 0 < less.sum() < more.sum() < 0.6 * len(less)
    assert min(less.min(), more.min()) >= 0
    assert max(less.max(), more.max()) <= 1 + 1e-12


def test_derivatives_use_the_flattened_points(drawn):
    inverse, _, shares = drawn
    flat = with_pressed_points(inverse, shares)
    free, h = unknowns(FREE, []), 1e-3
    z, scan = free.mean, flat.scans[1]
    found = derivatives(flat, scan, free, z, predict_scan(flat, scan, free, z, None)).columns
    for i in range(len(z)):
        step = h * np.eye(len(z))[i]
        there, back = (predict_scan(flat, scan, free, z + s, None) for s in (step, -step))
        expected = (there.residual - back.residual) / (2 * h)
        assert np.abs(found[:, i] - expected).max() < 2e-2 * np.abs(expected).max()


def test_problem_without_plates_is_unchanged(drawn):
    inverse, _, shares = drawn
    assert with_pressed_points(inverse, [0.0 * share for share in shares]) is inverse


def test_pressed_points_exclude_the_error_at_rest(drawn):
    """Two scans share the error of the scan at rest, except where a plate presses in either."""
    inverse, _, shares = drawn
    noise = replace(inverse.noise, reference_sd_mm=0.2, sd_mm=0.1)
    k = len(inverse.points)
    whole = covariance(inverse.points, noise, 2)
    found = covariance(inverse.points, noise, 2, 1.0 - np.stack(shares))
    pressed, free = shares[1] > 0.999, (shares[0] == 0) & (shares[1] == 0)
    between = np.diag(found[:k, k:])
    np.testing.assert_allclose(between[pressed], 0.0, atol=1e-4)
    np.testing.assert_allclose(between[free], 0.2**2, rtol=1e-9)
    np.testing.assert_allclose(np.diag(found[k:, k:])[pressed], 0.1**2 + 0.01**2, rtol=1e-2)
    np.testing.assert_array_equal(
        found[:k, :k][np.ix_(free, free)], whole[:k, :k][np.ix_(free, free)]
    )
    assert np.linalg.eigvalsh(found).min() > 0
