"""The smooth field in low rank against dense normal densities."""

from dataclasses import replace

import numpy as np
import pytest
from linear_world import (
    dense_log_density,
    field_draw,
    layout,
    mode,
    nominal_problem,
    observed,
    smooth_field,
)
from scipy.integrate import quad
from scipy.special import logsumexp
from scipy.stats import norm

from storage.errors import InputError
from workers.diagnosis.discrepancy import Discrepancy, SmoothField
from workers.diagnosis.evidence import log_evidence

K = 150  # points, 300 residuals


def dense(problem, columns=None, sd=()):
    """Lengths by amplitudes."""
    prior = SmoothField()
    return np.array(
        [
            [
                dense_log_density(problem, columns, sd, a**2 * prior.covariance(*layout(K), length))
                for a in prior.amplitudes_mm
            ]
            for length in prior.lengths_mm
        ]
    )


@pytest.fixture(scope="module")
def problem():
    rng = np.random.default_rng(21)
    return observed(nominal_problem(K), rng, field_draw(K, rng))


def test_covariance_is_that_of_a_displacement_field():
    """Draw the three components of the field at the points and look along the normals."""
    points, normals, states = layout(12)
    rng = np.random.default_rng(22)
    kernel = np.exp(-0.5 * ((points[:, None] - points) ** 2).sum(axis=2) / 20.0**2)
    kernel *= np.where(states[:, None] == states, 1.0, 0.8)
    factor = np.linalg.cholesky(kernel + 1e-10 * np.eye(24))
    fields = np.einsum("ij,jcn->icn", factor, rng.standard_normal((24, 3, 40000)))
    seen = np.einsum("icn,ic->in", fields, normals)
    expected = SmoothField().covariance(points, normals, states, 20.0)
    assert np.cov(seen) == pytest.approx(expected, abs=0.03)


def test_low_rank_equals_dense(problem):
    """Within 1e-4 nats at every amplitude and length."""
    found = smooth_field(K).log_evidences(problem)
    assert found == pytest.approx(dense(problem), abs=1e-4)


def test_low_rank_equals_dense_with_an_effect(problem):
    columns, sd = mode(K, (0, 1, 1), 0, 1.0)[:, None], np.array([0.8])
    found = smooth_field(K).log_evidences(problem.freed(columns, sd))
    assert found == pytest.approx(dense(problem, columns, sd), abs=1e-4)


def test_average_is_over_amplitudes_and_lengths(problem):
    expected = logsumexp(dense(problem)) - np.log(9)
    assert smooth_field(K).log_evidence(problem) == pytest.approx(expected, abs=1e-4)


def test_error_falls_with_the_tolerance(problem):
    exact = dense(problem)
    errors = []
    for tolerance in (1e-2, 1e-4, 1e-6):
        coarse = Discrepancy(*layout(K), problem.covariance_factor, tolerance=tolerance)
        errors.append(np.abs(coarse.log_evidences(problem) - exact).max())
    assert errors[1] < errors[0] / 20
    assert errors[2] < errors[1] / 20


def test_one_sided_parameter_with_the_field_against_an_integral():
    shape, prior = mode(K, (2, 0, 0), 1, 1.5), SmoothField((0.3,), (16.0,))
    problem = observed(nominal_problem(K), np.random.default_rng(23), -0.1 * shape)
    field = Discrepancy(*layout(K), problem.covariance_factor, prior)
    extra = 0.3**2 * prior.covariance(*layout(K), 16.0)
    base = dense_log_density(problem, extra=extra)

    def integrand(t):
        ahead = replace(problem, residual=problem.residual + t * shape)
        return 2 * norm.pdf(t) * np.exp(dense_log_density(ahead, extra=extra) - base)

    direct = np.log(quad(integrand, 0, 5, limit=60, epsabs=1e-7)[0]) + base
    freed = problem.freed(shape[:, None], np.ones(1))
    sided = np.array([False, False, False, True])
    assert field.log_evidence(freed, sided) == pytest.approx(direct, abs=1e-4)


def test_a_field_is_recognised_and_noise_is_not():
    rng = np.random.default_rng(24)
    with_field = [observed(nominal_problem(K), rng, field_draw(K, rng)) for _ in range(20)]
    without = [observed(nominal_problem(K), rng) for _ in range(20)]
    gains = [
        np.mean([smooth_field(K).log_evidence(p) - log_evidence(p) for p in problems])
        for problems in (with_field, without)
    ]
    assert gains[0] > 10
    assert gains[1] < -0.5


def test_ceiling_is_the_share_that_the_field_can_follow():
    """Against the truth: the part of a known field that the posterior mean reaches."""
    rng = np.random.default_rng(25)
    claimed, true = [], []
    for _ in range(12):
        field = field_draw(K, rng)
        if np.std(field) < 0.2:
            continue
        problem = observed(nominal_problem(K), rng, field)
        found = smooth_field(K).ceiling(problem)
        claimed.append(found.share)
        J = problem.nominal
        gap = field - J @ np.linalg.lstsq(J, field, rcond=None)[0]
        left = gap - found.field_mm
        left = left - J @ np.linalg.lstsq(J, left, rcond=None)[0]
        true.append(1 - (left @ left) / (gap @ gap))
    assert len(true) > 4
    assert np.mean(claimed) == pytest.approx(np.mean(true), abs=0.06)
    assert np.mean(true) > 0.7


def test_no_gap_has_no_ceiling():
    problem = nominal_problem(K)
    assert np.isnan(smooth_field(K).ceiling(problem).share)


def test_wrong_input_is_named(problem):
    with pytest.raises(InputError, match="made for 300 residuals, the fit has 120"):
        smooth_field(K).log_evidence(nominal_problem(60))
    with pytest.raises(InputError, match="amplitudes > 0"):
        SmoothField(amplitudes_mm=(0.0,))
    points, normals, states = layout(K)
    with pytest.raises(InputError, match="points"):
        Discrepancy(points[1:], normals, states, problem.covariance_factor)
