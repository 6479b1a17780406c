"""Noise that is larger at one end of the body than at the other."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.noise.noise_components import NoiseParts, smooth_columns
from palpate.workers.diagnosis.noise.noise_learning import with_factors, with_uneven_noise
from tests.workers.diagnosis.linear_world import NOISE_MM, ellipsoid, layout, mode

K = 300


def even_parts():
    """Return noise of two interfaces in two scans, correlated and with a numerical error."""
    points, _ = ellipsoid(K)
    own = (points[:, 1] < 0).astype(np.int32)
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    stated = NOISE_MM**2 * (np.exp(-0.5 * (distance / 6.0) ** 2) + 0.01 * np.eye(K))
    stated = np.kron(np.eye(2), stated * (own[:, None] == own))
    numerical = smooth_columns(*layout(K), np.full(2 * K, 0.05), 16.0, 1.0, 1e-8)
    return NoiseParts((stated,), (1.0,), np.tile(own, 2), np.zeros((2 * K, 0)), numerical)


@cache
def field():
    """Return an almost free field, as it is used to learn noise."""
    amplitude, length = SETTINGS.noise.learning_field
    return smooth_columns(*layout(K), np.full(2 * K, amplitude), length, 0.8, 1e-3)


def places_of(parts):
    return np.tile(ellipsoid(K)[0], (2, 1))


def factors_of(places, slopes):
    ends = places.min(axis=0), places.max(axis=0)
    return np.exp((places - sum(ends) / 2) / ((ends[1] - ends[0]) / 2) @ np.asarray(slopes))


def drawn(parts, rng):
    own = np.linalg.cholesky(parts.stated[0]) @ rng.standard_normal(parts.size)
    return own + parts.numerical @ rng.standard_normal(parts.numerical.shape[1])


def learnt_slopes(parts, residual):
    """Return the learnt slopes of the factors' logarithm, per half length of the body."""
    places = places_of(parts)
    found = np.log(with_uneven_noise(parts, places, field(), residual).factors)
    ends = places.min(axis=0), places.max(axis=0)
    t = (places - sum(ends) / 2) / ((ends[1] - ends[0]) / 2)
    return np.linalg.lstsq(t, found, rcond=None)[0]


@pytest.mark.parametrize(
    ("scale", "slopes"),
    [
        pytest.param(1.0, (0.0, 0.0, 0.0), marks=pytest.mark.slow),
        (0.5, (0.0, 0.0, 0.25)),
        pytest.param(2.0, (-0.2, 0.1, 0.0), marks=pytest.mark.slow),
    ],
)
def test_learns_slopes_whatever_noise_is_given(scale, slopes):
    """Means over six bodies are within 0.05."""
    rng = np.random.default_rng(71)
    parts = even_parts()
    true = with_factors(parts, scale * factors_of(places_of(parts), slopes))
    found = [learnt_slopes(parts, drawn(true, rng)) for _ in range(6)]
    assert np.mean(found, axis=0) == pytest.approx(slopes, abs=0.05)


def test_a_smooth_effect_at_one_end_is_not_learnt_as_noise():
    """An effect of 2 mm that grows along z is added to noise of a quarter of a millimetre."""
    rng = np.random.default_rng(72)
    parts = even_parts()
    found = learnt_slopes(parts, drawn(parts, rng) + mode(K, (0, 0, 1), 2, 2.0))
    assert np.abs(found).max() < 0.15


def test_factors_scale_the_covariance():
    """Factors scale standard deviations, so they multiply rows and columns of the covariance."""
    parts = even_parts()
    factors = factors_of(places_of(parts), (0.0, 0.0, 0.3))
    uneven = with_factors(parts, factors)
    assert np.sqrt(np.diag(uneven.stated[0])) == pytest.approx(
        factors * np.sqrt(np.diag(parts.stated[0]))
    )
    assert uneven.stated[0][0, 1] == pytest.approx(parts.stated[0][0, 1] * factors[0] * factors[1])
    assert parts.factors == pytest.approx(np.ones(parts.size))
    assert replace(uneven, uneven=None).factors == pytest.approx(np.ones(parts.size))
