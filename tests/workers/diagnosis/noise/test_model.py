"""Noise of unknown size, nuisances and the smooth field, compared with dense normal densities."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import logsumexp
from scipy.stats import norm

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.linearisation import factored
from palpate.workers.diagnosis.noise.averaged_evidence import NoiseModel
from palpate.workers.diagnosis.noise.noise_components import (
    NoiseParts,
    NoiseState,
    drawing_columns,
    pose_columns,
    smooth_columns,
    smooth_covariance,
)
from palpate.workers.diagnosis.noise.noise_learning import learnt_states
from tests.workers.diagnosis.linear_world import (
    FIELD,
    NOISE_MM,
    NUGGET_MM,
    dense_log_density,
    ellipsoid,
    field_draw,
    hypothesis_of,
    known_noise_model,
    layout,
    mode,
    nominal_problem,
    observed,
)

K = 150  # points, 300 residuals


def dense(problem, columns=None, sd=()):
    """Return log evidences, an array of lengths by amplitudes."""
    return np.array(
        [
            [
                dense_log_density(
                    problem, columns, sd, a**2 * smooth_covariance(*layout(K), length, 0.8)
                )
                for a in FIELD.amplitudes_mm
            ]
            for length in FIELD.lengths_mm
        ]
    )


def constant_of(problem):
    """Return ln|C| / 2, which `dense_log_density` omits."""
    return float(np.log(np.diag(problem.covariance_factor)).sum())


def with_field(problem, sided=None, **options):
    """Return the log evidence with the smooth field."""
    noise, at = known_noise_model(K, **options), hypothesis_of(problem, sided)
    return noise.log_evidence(at) + noise.field_gain(at) + constant_of(problem)


@pytest.fixture(scope="module")
def problem():
    rng = np.random.default_rng(21)
    return observed(nominal_problem(K), rng, field_draw(K, rng))


def test_covariance_matches_a_displacement_field():
    """The three components of the field are drawn at the points and projected on the normals."""
    points, normals, states = layout(12)
    rng = np.random.default_rng(22)
    kernel = np.exp(-0.5 * ((points[:, None] - points) ** 2).sum(axis=2) / 20.0**2)
    kernel *= np.where(states[:, None] == states, 1.0, 0.8)
    factor = np.linalg.cholesky(kernel + 1e-10 * np.eye(24))
    fields = np.einsum("ij,jcn->icn", factor, rng.standard_normal((24, 3, 40000)))
    seen = np.einsum("icn,ic->in", fields, normals)
    expected = smooth_covariance(points, normals, states, 20.0, 0.8)
    assert np.cov(seen) == pytest.approx(expected, abs=0.03)


def test_low_rank_equals_dense(problem):
    """The averages over amplitudes and lengths agree within 1e-4 nats."""
    expected = logsumexp(dense(problem)) - np.log(9)
    assert with_field(problem) == pytest.approx(expected, abs=1e-4)


def test_low_rank_equals_dense_with_an_effect(problem):
    columns, sd = mode(K, (0, 1, 1), 0, 1.0)[:, None], np.array([0.8])
    expected = logsumexp(dense(problem, columns, sd)) - np.log(9)
    assert with_field(problem.freed(columns, sd)) == pytest.approx(expected, abs=1e-4)


def test_low_rank_error_falls_with_the_tolerance(problem):
    exact = logsumexp(dense(problem)[-1]) - np.log(3)
    longest = FIELD.lengths_mm[-1:]
    errors = [
        abs(with_field(problem, tolerance=t, lengths=longest) - exact) for t in (1e-1, 1e-3, 1e-5)
    ]
    assert errors[1] < errors[0] / 20
    assert errors[2] < errors[1] / 20


@pytest.mark.slow
def test_one_sided_parameter_with_the_field_matches_an_integral():
    shape = mode(K, (2, 0, 0), 1, 1.5)
    problem = observed(nominal_problem(K), np.random.default_rng(23), -0.1 * shape)
    extra = 0.3**2 * smooth_covariance(*layout(K), 16.0, 0.8)
    base = dense_log_density(problem, extra=extra)

    def integrand(t):
        ahead = replace(problem, residual=problem.residual + t * shape)
        return 2 * norm.pdf(t) * np.exp(dense_log_density(ahead, extra=extra) - base)

    direct = np.log(quad(integrand, 0, 5, limit=60, epsabs=1e-7)[0]) + base
    freed = problem.freed(shape[:, None], np.ones(1))
    sided = np.array([False, False, False, True])
    found = with_field(freed, sided, lengths=(16.0,), amplitudes=(0.3,))
    assert found == pytest.approx(direct, abs=1e-4)


def test_a_field_raises_the_evidence_but_noise_does_not():
    rng, noise = np.random.default_rng(24), known_noise_model(K)
    fields = [observed(nominal_problem(K), rng, field_draw(K, rng)) for _ in range(20)]
    none = [observed(nominal_problem(K), rng) for _ in range(20)]
    gains = [np.mean([noise.field_gain(hypothesis_of(p)) for p in some]) for some in (fields, none)]
    assert gains[0] > 10
    assert gains[1] < -0.5


# --- nuisances and learnt noise --------------------------------------------------


def interfaces():
    """Return the interface of each point: one for the upper half, another for the lower half."""
    return (ellipsoid(K)[0][:, 2] < 0).astype(np.int32)


def parts_of(problem):
    """Return noise of two independent interfaces, with poses, drawing and numerical errors."""
    points, normals = ellipsoid(K)
    own = np.tile(interfaces(), 2)
    stated = problem.covariance * (own[:, None] == own)
    pose = pose_columns([points] * 2, [normals] * 2, (0.0, 0.0, 0.0), 0.3, 0.3)
    drawing = drawing_columns(interfaces(), 2, 0.03, 0.03)
    numerical = smooth_columns(*layout(K), np.full(2 * K, 0.05), 16.0, 1.0, 1e-8)
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    longer = NOISE_MM**2 * np.kron(np.eye(2), np.exp(-0.5 * (distance / 24.0) ** 2))
    longer = (longer + NUGGET_MM**2 * np.eye(2 * K)) * (own[:, None] == own)
    return NoiseParts((stated, longer), (1.0, 4.0), own, np.hstack([pose, drawing]), numerical)


def drawn(parts, scales, rng, numerical=1.0):
    """Return a residual drawn from that noise, with constants at their prior means."""
    covariance = parts.scatter(0, np.asarray(scales), numerical) + parts.fixed @ parts.fixed.T
    return np.linalg.cholesky(covariance) @ rng.standard_normal(parts.size)


def learnt(parts, residual):
    problem = nominal_problem(K)
    amplitude, length = SETTINGS.noise.learning_field
    field = smooth_columns(*layout(K), np.full(2 * K, amplitude), length, 0.8, 1e-3)
    return learnt_states(parts, problem.nominal * problem.nominal_sd, residual, field)


@pytest.mark.parametrize("zeta", [1.0, 0.3])
def test_evidence_is_averaged_over_noise_states(zeta: float):
    """It equals the mean of the states' dense densities, with poses in the covariance.

    The power zeta of a normal density is a density of covariance S / zeta, times |S / zeta|^(1/2)
    |S|^(-zeta / 2); only the segmentation noise is coarsened.
    """
    problem = observed(nominal_problem(K), np.random.default_rng(61))
    parts = parts_of(problem)
    states = [
        NoiseState(0, np.array([1.1, 0.8]), 0.5, np.log(0.7)),
        NoiseState(1, np.array([0.9, 1.3]), 2.0, np.log(0.3)),
    ]
    logs = []
    for state in states:
        scatter = parts.scatter(state.length, state.scales, state.numerical)
        drawn_alone = parts.scatter(state.length, state.scales, 0.0)
        whole = scatter + (1 / zeta - 1) * drawn_alone + parts.fixed @ parts.fixed.T
        there = replace(problem, covariance_factor=factored(whole))
        _, log_determinant = np.linalg.slogdet(drawn_alone)
        factor = (log_determinant - parts.size * np.log(zeta) - zeta * log_determinant) / 2
        logs.append(dense_log_density(there) - constant_of(there) + factor + state.log_weight)
    found = NoiseModel(parts, states).coarsened(zeta).log_evidence(hypothesis_of(problem))
    assert found == pytest.approx(logsumexp(logs), abs=1e-8)


@pytest.mark.parametrize(
    "scales",
    [
        (1.0, 1.0),
        pytest.param((0.5, 0.5), marks=pytest.mark.slow),
        pytest.param((2.0, 2.0), marks=pytest.mark.slow),
        (0.8, 1.3),
    ],
)
def test_misstated_noise_is_learnt(scales):
    """Means over ten bodies are within 5 %, despite pose, drawing and numerical errors."""
    rng = np.random.default_rng(62)
    parts = parts_of(nominal_problem(K))
    found = [learnt(parts, drawn(parts, scales, rng))[0] for _ in range(10)]
    assert np.mean([s.scales for s in found], axis=0) == pytest.approx(scales, rel=0.05)


def test_a_strong_effect_is_not_learnt_as_noise():
    """A smooth effect of 1 mm is added to noise of 0.25 mm."""
    rng = np.random.default_rng(63)
    parts = parts_of(nominal_problem(K))
    residual = drawn(parts, (1.0, 1.0), rng) + mode(K, (1, 1, 0), 2, 1.0)
    assert learnt(parts, residual)[0].scales == pytest.approx([1.0, 1.0], rel=0.2)


def test_a_pose_error_is_no_evidence_for_an_effect():
    """Scans 0.4 mm and 0.4 degrees apart give hundreds of nats without poses, none with poses."""
    rng = np.random.default_rng(64)
    problem = nominal_problem(K)
    parts = parts_of(problem)
    points, normals = ellipsoid(K)
    poses = pose_columns([points] * 2, [normals] * 2, (0.0, 0.0, 0.0), 0.4, 0.4)
    residual = drawn(parts, (1.0, 1.0), rng) + poses @ rng.standard_normal(12)
    at = replace(hypothesis_of(problem), residual=residual)
    fields = [smooth_columns(*layout(K), np.ones(2 * K), 20.0, 0.8, 1e-3)]
    states = [NoiseState(0, np.ones(2), 1.0, 0.0)]
    ignorant = replace(parts, fixed=np.zeros((parts.size, 0)))
    assert NoiseModel(ignorant, states, fields).field_gain(at) > 20
    assert NoiseModel(parts, states, fields).field_gain(at) < 0


def test_unlikely_noise_states_are_omitted():
    rng = np.random.default_rng(65)
    parts = parts_of(nominal_problem(K))
    found = learnt(parts, drawn(parts, (1.0, 1.0), rng))
    assert found[0].length == 0
    assert len(found) < len(parts.lengths) * len(SETTINGS.noise.numerical_scales)
    assert logsumexp([s.log_weight for s in found]) == pytest.approx(0.0)


def test_rejects_invalid_input():
    parts = parts_of(nominal_problem(K))
    with pytest.raises(InputError, match="The noise of 300 residuals"):
        replace(parts, fixed=parts.fixed[1:])
