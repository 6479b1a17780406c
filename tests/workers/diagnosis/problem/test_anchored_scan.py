"""Scans with the same noise for every hypothesis, on surfaces with known distances."""

from typing import Any, cast

import numpy as np
import pytest

from palpate.workers.diagnosis.problem.inverse_problem import Scan
from palpate.workers.diagnosis.problem.scan_noise import anchored

LENGTH_MM, SD_MM = 4.0, 0.3
RNG = np.random.default_rng(3)
WAVES = RNG.standard_normal((2, 200)) / LENGTH_MM
PHASES = RNG.uniform(0, 2 * np.pi, 200)
POINTS = np.c_[RNG.uniform(-60, 60, (400, 2)), np.zeros(400)]
NOTHING = cast(Any, None)


def drawn_plane(points, of):
    """Return the distance from a plane drawn with errors of 0.3 mm over 4 mm, and its slope."""
    waves = np.cos(points[:, :2] @ WAVES + PHASES) * SD_MM * np.sqrt(2 / 200)
    slopes = -np.sin(points[:, :2] @ WAVES + PHASES) * SD_MM * np.sqrt(2 / 200) @ WAVES.T
    return points[:, 2] - waves.sum(axis=1), np.c_[-slopes, np.ones(len(points))]


def ball(points, of):
    far = np.linalg.norm(points, axis=1)
    return far - 40.0, points / far[:, None]


def scan(compare):
    return Scan("scan", lambda values: NOTHING, compare)


def rms(values):
    return np.sqrt((values**2).mean())


def test_residuals_at_the_anchor_are_unchanged():
    there = anchored(scan(drawn_plane), POINTS, NOTHING, LENGTH_MM)
    np.testing.assert_allclose(
        there.compare(POINTS, NOTHING)[0], drawn_plane(POINTS, NOTHING)[0], atol=1e-12
    )


def test_a_body_that_slides_keeps_its_noise():
    """Sliding by 3 mm does not move the plane, but its error would differ if evaluated again."""
    there = anchored(scan(drawn_plane), POINTS, NOTHING, LENGTH_MM)
    at_rest = drawn_plane(POINTS, NOTHING)[0]
    slid = POINTS + np.array([3.0, 0.0, 0.0])
    anew = rms(drawn_plane(slid, NOTHING)[0] - at_rest)
    kept = rms(there.compare(slid, NOTHING)[0] - at_rest)
    assert anew > 0.2
    # A disc of two correlation lengths leaves 0.28 of the noise's slope.
    assert kept < 0.3 * anew


def test_normal_motion_is_fully_visible():
    there = anchored(scan(drawn_plane), POINTS, NOTHING, LENGTH_MM)
    raised = there.compare(POINTS + np.array([0.0, 0.0, 1.5]), NOTHING)[0]
    np.testing.assert_allclose(raised, 1.5 + drawn_plane(POINTS, NOTHING)[0], atol=1e-9)


@pytest.mark.parametrize("step", [0.5, 2.0])
def test_distance_of_a_round_body_is_unbiased(step):
    """The bias of a disc cancels for a ball that grows and for a ball that rotates."""
    on = 40.0 * RNG.standard_normal((200, 3))
    on *= 40.0 / np.linalg.norm(on, axis=1)[:, None]
    there = anchored(scan(ball), on, NOTHING, LENGTH_MM)
    grown = on * (1 + step / 40)
    np.testing.assert_allclose(there.compare(grown, NOTHING)[0], step, atol=0.02)
    turned = on + np.cross([0.0, 0.0, step / 40], on)
    np.testing.assert_allclose(
        there.compare(turned, NOTHING)[0], ball(turned, NOTHING)[0], atol=0.02
    )


def test_growth_of_a_small_lump_is_unbiased():
    """At a radius of 8 mm, a disc of the noise's length is not flat, and its mean is less steep."""
    on = RNG.standard_normal((200, 3))
    on *= 8.0 / np.linalg.norm(on, axis=1)[:, None]
    lump = scan(lambda points, of: (ball(points, of)[0] + 32.0, ball(points, of)[1]))
    there = anchored(lump, on, NOTHING, LENGTH_MM)
    np.testing.assert_allclose(there.compare(on * (1 + 0.5 / 8), NOTHING)[0], 0.5, atol=0.02)
    np.testing.assert_allclose(
        np.linalg.norm(there.compare(on, NOTHING)[1], axis=1), 1.0, atol=1e-9
    )


def test_normals_are_the_derivatives_of_distances():
    there = anchored(scan(drawn_plane), POINTS, NOTHING, LENGTH_MM)
    at = POINTS + np.array([1.0, 0.5, 0.3])
    normals = there.compare(at, NOTHING)[1]
    for axis in np.eye(3):
        ahead, behind = (there.compare(at + h * axis, NOTHING)[0] for h in (1e-4, -1e-4))
        np.testing.assert_allclose(normals @ axis, (ahead - behind) / 2e-4, atol=1e-6)
