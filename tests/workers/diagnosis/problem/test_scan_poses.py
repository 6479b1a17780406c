"""Averaging over pose scales: its benefit, and comparison with dense densities."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.noise.noise_components import correlated, pose_columns
from palpate.workers.diagnosis.outcome.averaged_posteriors import parameter_posterior
from palpate.workers.mechanics.effects.observation_effects import rigid_columns
from tests.workers.diagnosis.linear_world import (
    dense_log_density,
    hypothesis_of,
    known_noise_model,
    layout,
    mode,
    nominal_problem,
    observed,
)

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


def posed(problem):
    return hypothesis_of(problem).with_errors(poses(), are_poses=True)


def test_evidence_is_the_mean_over_pose_scales():
    problem = observed(nominal_problem(K), np.random.default_rng(31))
    expected = [
        dense_log_density(problem, scale * poses(), np.ones(12)) for scale in SETTINGS.pose.scales
    ]
    nothing = dense_log_density(problem)
    noise = known_noise_model(K)
    found = noise.log_evidence(posed(problem)) - noise.log_evidence(hypothesis_of(problem))
    mean = logsumexp(expected) - np.log(len(expected))
    assert found == pytest.approx(mean - nothing, abs=1e-6)


def gain_of_the_shift(rng, *, off_mm):
    """Return the evidence for a shift of 0.3 mm over poses alone, for pose errors of `off_mm`."""
    problem = nominal_problem(K)
    off = poses() @ rng.standard_normal(12) * off_mm / SD[0]
    seen = observed(problem, rng, 0.3 * shift() + off)
    noise = known_noise_model(K)
    with_shift = posed(seen.freed(shift()[:, None], np.array([0.5])))
    return noise.log_evidence(with_shift) - noise.log_evidence(posed(seen))


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


def test_separates_a_shift_from_small_pose_errors():
    rng = np.random.default_rng(32)
    there = np.array([gain_of_the_shift(rng, off_mm=0.0) for _ in range(20)])
    assert np.median(there) > 3
    off = np.array([gain_of_the_shift(rng, off_mm=0.3) for _ in range(20)])
    assert np.median(off) < 2


def test_pose_errors_are_not_reported_as_a_shift():
    """No shift is reported for bodies without one, whatever their poses."""
    rng = np.random.default_rng(33)
    problem, noise = nominal_problem(K), known_noise_model(K)
    for off_mm in (0.0, 0.1, 0.3):
        for _ in range(10):
            off = poses() @ rng.standard_normal(12) * off_mm / SD[0]
            seen = observed(problem, rng, off)
            with_shift = posed(seen.freed(shift()[:, None], np.array([0.5])))
            assert noise.log_evidence(with_shift) - noise.log_evidence(posed(seen)) < 3


def around_nothing(problem):
    """Return the parts of a fit's unknowns that `parameter_posterior` uses."""
    sd = problem.nominal_sd
    nothing = np.zeros(len(sd))
    return SimpleNamespace(mean=nothing, sd=sd, lower=nothing - 9.0, upper=nothing + 9.0)


def test_shift_size_is_unbiased_for_small_pose_errors():
    """With a pose prior of 0.3 mm alone, half of the shift would be attributed to the poses."""
    rng = np.random.default_rng(34)
    found, spread = [], []
    for _ in range(20):
        seen = observed(nominal_problem(K), rng, -0.3 * shift())
        free = seen.freed(shift()[:, None], np.array([0.5]))
        posterior = parameter_posterior(known_noise_model(K), posed(free), around_nothing(free))
        found.append(posterior.mean[-1])
        spread.append(posterior.sd[-1])
    assert np.mean(found) == pytest.approx(0.3, abs=0.06)
    inside = np.abs(np.array(found) - 0.3) < 2 * np.array(spread)
    assert inside.mean() >= 0.85
