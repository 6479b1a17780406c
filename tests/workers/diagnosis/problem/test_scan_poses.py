"""Poses of the scans: their columns, and evidence beside them."""

import numpy as np
import pytest

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.laplace_evidence import log_evidence
from palpate.workers.diagnosis.noise.noise_components import correlated, pose_columns
from palpate.workers.mechanics.effects.observation_effects import rigid_columns
from tests.workers.diagnosis.linear_world import layout, mode, nominal_problem, observed

K = 60
SD = SETTINGS.pose.shift_sd_mm, SETTINGS.pose.turn_sd_deg


def poses():
    points, normals, states = layout(K)
    of_scan = [states == 0, states == 1]
    each = [points[one] for one in of_scan], [normals[one] for one in of_scan]
    return pose_columns(*each, (0.0, 0.0, 0.0), *SD)


def shift():
    """Return a body force that shifts the body in proportion to its load."""
    return mode(K, (0, 0, 0), 0, 1.0)


def gain_of_the_shift(rng, shift_mm, off_mm):
    """Return the evidence for a shift over poses alone, for pose errors of `off_mm`."""
    off = poses() @ rng.standard_normal(12) * off_mm / SD[0]
    posed = observed(nominal_problem(K), rng, shift_mm * shift() + off).freed(poses(), np.ones(12))
    with_shift = posed.freed(shift()[:, None], np.array([1.0]))
    return log_evidence(with_shift) - log_evidence(posed)


def test_the_pose_of_the_scan_at_rest_is_common_to_all_scans():
    """Columns times their transpose give the poses of both scans, plus a common pose."""
    points, normals = np.eye(3)[[0, 1, 2, 0]] * 30.0, np.eye(3)[[1, 2, 0, 2]]
    columns = pose_columns([points] * 2, [normals] * 2, (0.0, 0.0, 0.0), 0.3, 0.2)
    one = rigid_columns(points, normals, (0.0, 0.0, 0.0)) * np.repeat([0.3, 0.2], 3)
    expected = np.kron([[2.0, 1.0], [1.0, 2.0]], one @ one.T)
    np.testing.assert_allclose(columns @ columns.T, expected, atol=1e-12)
    free = np.random.default_rng(3).standard_normal((2, 6))
    moved = [one @ pose for pose in correlated(free)]
    np.testing.assert_allclose(columns @ free.ravel(), np.concatenate(moved), atol=1e-12)


@pytest.mark.parametrize("off_mm", [0.0, 0.1, 0.3])
def test_pose_errors_are_not_reported_as_a_shift(off_mm):
    """No shift is reported for bodies without one, whatever their poses."""
    rng = np.random.default_rng(33)
    assert max(gain_of_the_shift(rng, 0.0, off_mm) for _ in range(20)) < 3


def test_a_shift_larger_than_pose_errors_is_seen():
    rng = np.random.default_rng(32)
    found = {mm: np.median([gain_of_the_shift(rng, mm, 0.3) for _ in range(20)]) for mm in (0.3, 3)}
    assert found[0.3] < 2
    assert found[3] > SETTINGS.selection.first
