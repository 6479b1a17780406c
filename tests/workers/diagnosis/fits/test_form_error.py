"""Form errors: their influence on the evidence for weak and strong effects."""

import numpy as np
import pytest

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.model_errors import FormError, acting_or_alike
from tests.workers.diagnosis.linear_world import (
    hypothesis_of,
    known_noise_model,
    layout,
    mode,
    nominal_problem,
    observed,
)

K = 150
ALIKE = np.array([[1.0, 0.9], [0.9, 1.0]])


@pytest.fixture(scope="module")
def form():
    points, normals, states = layout(K)
    return FormError(points, normals, states, ALIKE, 20.0)


def test_errors_are_as_large_as_the_pattern_around_them(form):
    """At each point, columns for an error of size one have the deviation of the pattern."""
    pattern = mode(K, (0, 1, 1), 0, 1.0)
    deviation = np.sqrt((form.columns(pattern) ** 2).sum(axis=1))
    assert deviation / form.envelope(pattern) == pytest.approx(np.ones(2 * K), rel=0.02)


def test_errors_grow_with_the_effect_and_are_smooth(form):
    pattern = mode(K, (0, 1, 1), 0, 1.0)
    assert form.columns(3.0 * pattern) == pytest.approx(3.0 * form.columns(pattern))
    assert form.columns(pattern).shape[1] < K


def test_form_error_moves_both_sides_of_a_layer_together():
    """A displacement that raises the residual on one side lowers it on the other."""
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    layer = FormError(points, normals, np.zeros(2, np.int32), np.ones((1, 1)), 20.0)
    errors = layer.columns(np.array([1.0, -1.0]))
    covariance = errors @ errors.T
    assert covariance[0, 1] / covariance[0, 0] == pytest.approx(-1.0, abs=0.03)


def test_error_length_scales_with_the_organ():
    """Errors of points one field length apart correlate equally, whatever the length in mm."""
    found = []
    for length_mm in (1.5, 20.0):
        points = np.array([[0.0, 0.0, 0.0], [length_mm, 0.0, 0.0]])
        normals = np.tile([0.0, 0.0, 1.0], (2, 1))
        form = FormError(points, normals, np.zeros(2, np.int32), np.ones((1, 1)), length_mm)
        errors = form.columns(np.ones(2))
        found.append(errors @ errors.T)
    assert found[0] == pytest.approx(found[1])
    assert found[0][0, 1] < 0.9 * found[0][0, 0]


SIZES = SETTINGS.form.relative_sds


def evidences(columns, problem, errors, *, field):
    at = hypothesis_of(problem.freed(columns[:, None], np.ones(1)))
    return known_noise_model(K).log_evidences_with_errors(at, errors, SIZES)[field]


def test_evidence_of_each_size_matches_scaled_columns(form):
    listed = mode(K, (0, 1, 1), 0, 1.0)
    problem = observed(nominal_problem(K), np.random.default_rng(70), -0.5 * listed)
    errors, noise = form.columns(listed), known_noise_model(K)
    at = hypothesis_of(problem.freed(listed[:, None], np.ones(1)))
    wide = [at.with_errors(size * errors) for size in SIZES]
    expected = np.array([noise.log_evidence(one) for one in wide])
    assert evidences(listed, problem, errors, field=False) == pytest.approx(expected)
    expected += [noise.field_gain(one) for one in wide]
    assert evidences(listed, problem, errors, field=True) == pytest.approx(expected)


def test_a_strong_effect_of_another_form_hardly_needs_a_field(form):
    """An effect of 2 mm is a quarter larger on one side than in the catalogue."""
    points, _, _ = layout(K)
    listed = mode(K, (0, 1, 1), 0, 1.0)
    true = listed * (1 + 0.25 * np.sin(points[:, 0] / 30.0))
    problem = observed(nominal_problem(K), np.random.default_rng(71), -2.0 * true)
    errors = form.columns(2.0 * listed)
    certain = known_noise_model(K).field_gain(
        hypothesis_of(problem.freed(listed[:, None], np.ones(1)))
    )
    alone, acting = acting_or_alike(evidences(listed, problem, errors, field=False))
    beside, _ = acting_or_alike(evidences(listed, problem, errors, field=True))
    assert certain > 40
    assert beside - alone < 0.25 * certain
    assert acting > 0.95


def test_weak_effects_lose_little_evidence(form):
    """Effects of 0.1 mm have evidence of some 5 to 15 nats."""
    listed = mode(K, (0, 1, 1), 0, 1.0)
    problem = observed(nominal_problem(K), np.random.default_rng(72), -0.1 * listed)
    errors = form.columns(0.1 * listed)
    certain = known_noise_model(K).log_evidence(
        hypothesis_of(problem.freed(listed[:, None], np.ones(1)))
    )
    doubtful, acting = acting_or_alike(evidences(listed, problem, errors, field=False))
    assert abs(doubtful - certain) < 0.5
    assert acting > 0.95


def test_log_odds_of_acting_fall_linearly_with_the_log_of_the_error():
    """For two Gaussians of width s about a and b, the slope is ln(b / a) / s^2 in ln size."""
    form, odds = SETTINGS.form, []
    for size in SIZES:
        _, acting = acting_or_alike([0.0 if one == size else -1e3 for one in SIZES])
        assert acting > 0.5
        odds.append(np.log(acting / (1 - acting)))
    fall = np.log(form.likeness_sd / form.typical_sd) / form.log_sd**2
    assert fall > 0
    assert np.diff(odds) == pytest.approx(-fall * np.diff(np.log(SIZES)))


def test_uninformative_data_leave_the_prior(form):
    either, acting = acting_or_alike([-7.0] * len(SIZES))
    assert either == pytest.approx(-7.0)
    assert acting == pytest.approx(1 - SETTINGS.form.likeness)
