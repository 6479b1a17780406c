"""Signed distances from the surfaces of a section, calculated by hand."""

import numpy as np
import pytest

from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.organs.cornea.section_comparison import SurfaceResidual, signed_distances
from palpate.workers.organs.cornea.section_outline import Section

FLAT = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])


def test_distances_from_a_straight_line_match_hand_calculation() -> None:
    r"""Points above and below ::

        *  0.5
    ----+----+----
             *  -0.2
    """
    above, normal = signed_distances(np.array([[1.0, 0.5], [2.3, -0.2]]), FLAT)
    np.testing.assert_allclose(above, [0.5, -0.2])
    np.testing.assert_allclose(normal, [[0, 1], [0, 1]])


def test_distance_is_positive_outside_both_surfaces() -> None:
    section = Section(FLAT + np.array([0.0, 1.0]), FLAT)
    points = np.array([[1.5, 1.1, 0.0], [1.5, -0.1, 0.0]])
    reference = InterfacePoints(
        points, np.zeros((2, 3)), np.array([0, 1], np.int32), np.ones(2), np.array([0, 1], np.int32)
    )
    residual, normals = SurfaceResidual(section)(points, reference)
    np.testing.assert_allclose(residual, [0.1, 0.1])
    np.testing.assert_allclose(normals, [[0, 1, 0], [0, -1, 0]])


def test_distances_from_a_circle_and_their_slope_match_hand_calculation() -> None:
    angle = np.linspace(2.5, 0.6, 400)
    circle = 7.8 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rng = np.random.default_rng(0)
    at = rng.uniform(0.9, 2.2, 50)
    radius = 7.8 + rng.uniform(-0.3, 0.3, 50)
    points = radius[:, None] * np.stack([np.cos(at), np.sin(at)], axis=1)
    above, normal = signed_distances(points, circle)
    np.testing.assert_allclose(above, radius - 7.8, atol=3e-5)
    step = 1e-4 * rng.standard_normal((50, 2))
    moved, _ = signed_distances(points + step, circle)
    assert moved - above == pytest.approx((step * normal).sum(axis=1), abs=2e-6)
