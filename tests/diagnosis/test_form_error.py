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
    points, normals, states = layout(K)
    return FormError(points, normals, states, 20.0)


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


def test_they_move_both_sides_of_a_layer_alike():
    """The error of a displacement is one up on this side and one down on the other."""
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    layer = FormError(points, normals, np.zeros(2, np.int32), 20.0)
    errors = layer.columns(np.array([1.0, -1.0]))
    covariance = errors @ errors.T
    assert covariance[0, 1] / covariance[0, 0] == pytest.approx(-1.0, abs=0.03)


def test_they_are_as_smooth_as_the_organ_is_large():
    """Of one length of the field apart, whatever that is in mm."""
    found = []
    for length_mm in (1.5, 20.0):
        points = np.array([[0.0, 0.0, 0.0], [length_mm, 0.0, 0.0]])
        normals = np.tile([0.0, 0.0, 1.0], (2, 1))
        form = FormError(points, normals, np.zeros(2, np.int32), length_mm)
        errors = form.columns(np.ones(2))
        found.append(errors @ errors.T)
    assert found[0] == pytest.approx(found[1])
    assert found[0][0, 1] < 0.9 * found[0][0, 0]


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
