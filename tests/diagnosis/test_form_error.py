"""Errors of form: what they cost a weak effect, and what they forgive a strong one."""

import numpy as np
import pytest
from linear_world import (
    hypothesis_of,
    known_noise_model,
    layout,
    mode,
    nominal_problem,
    observed,
)

from workers.diagnosis.form_error import FormError
from workers.diagnosis.settings import SETTINGS

K = 150


@pytest.fixture(scope="module")
def form():
    points, _, states = layout(K)
    return FormError(points, states)


def test_errors_are_a_fifth_of_the_pattern(form):
    """Their deviation at a point over the pattern around it."""
    pattern = mode(K, (0, 1, 1), 0, 1.0)
    columns = form.columns(pattern)
    deviation = np.sqrt((columns**2).sum(axis=1))
    ratio = deviation / form.envelope(pattern)
    assert ratio == pytest.approx(np.full(2 * K, SETTINGS.form.relative_sd), rel=0.02)


def test_they_grow_with_the_effect_and_are_smooth(form):
    pattern = mode(K, (0, 1, 1), 0, 1.0)
    assert form.columns(3.0 * pattern) == pytest.approx(3.0 * form.columns(pattern))
    assert form.columns(pattern).shape[1] < K


def evidence(columns, problem, errors=None):
    at = hypothesis_of(problem.freed(columns[:, None], np.ones(1)))
    at = at if errors is None else at.with_errors(errors)
    noise = known_noise_model(K)
    return noise.log_evidence(at), noise.field_gain(at)


def test_a_strong_effect_of_another_form_hardly_needs_a_field(form):
    """2 mm of an effect that is a quarter larger on one side than the catalogue says."""
    points, _, _ = layout(K)
    listed = mode(K, (0, 1, 1), 0, 1.0)
    true = listed * (1 + 0.25 * np.sin(points[:, 0] / 30.0))
    problem = observed(nominal_problem(K), np.random.default_rng(71), -2.0 * true)
    _, ignorant = evidence(listed, problem)
    _, aware = evidence(listed, problem, form.columns(2.0 * listed))
    assert ignorant > 40
    assert aware < 0.25 * ignorant


def test_a_weak_effect_is_hardly_hurt(form):
    """Of 0.1 mm, whose evidence is some 5 to 15 nats."""
    listed = mode(K, (0, 1, 1), 0, 1.0)
    problem = observed(nominal_problem(K), np.random.default_rng(72), -0.1 * listed)
    certain, _ = evidence(listed, problem)
    doubtful, _ = evidence(listed, problem, form.columns(0.1 * listed))
    assert abs(doubtful - certain) < 0.5
