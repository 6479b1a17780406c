"""Averages over a neighbourhood preserve constants and reduce noise according to the weights."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.outcome.residual_maps import local_mean

K = 60
POINTS = np.stack([np.arange(K) * 2.0, np.zeros(K), np.zeros(K)], axis=1)
UP = np.tile([0.0, 0.0, 1.0], (K, 1))
ONE = np.zeros(K, np.int32)


def test_a_constant_gap_is_preserved_and_scans_do_not_mix():
    residual = np.repeat([[0.4], [-0.2]], K, axis=1)
    mean, _ = local_mean(POINTS, UP, ONE, residual, np.eye(2 * K))
    np.testing.assert_allclose(mean, residual, rtol=1e-12)


def test_averaging_reduces_independent_but_not_common_noise():
    """The sum of squares of Gaussian weights is h / (2 sqrt(pi) L) on a line of spacing h."""
    residual = np.zeros((1, K))
    _, sd = local_mean(POINTS, UP, ONE, residual, 0.09 * np.eye(K), length_mm=8.0)
    middle = K // 2
    assert sd[0, middle] == pytest.approx(0.3 * np.sqrt(2.0 / (2 * np.sqrt(np.pi) * 8.0)), rel=1e-6)
    assert sd[0, 0] > 1.3 * sd[0, middle]  # an end has half as many neighbours
    _, common = local_mean(POINTS, UP, ONE, residual, 0.09 * np.ones((K, K)))
    np.testing.assert_allclose(common, 0.3, rtol=1e-12)


def test_standard_deviation_matches_draws():
    rng = np.random.default_rng(2)
    root = rng.standard_normal((2 * K, 2 * K)) / 10
    drawn = (root @ rng.standard_normal((2 * K, 3000))).T.reshape(-1, 2, K)
    means = [local_mean(POINTS, UP, ONE, one, np.eye(2 * K))[0] for one in drawn[:800]]
    _, sd = local_mean(POINTS, UP, ONE, drawn[0], root @ root.T)
    np.testing.assert_allclose(np.std(means, axis=0), sd, rtol=0.12)


def test_interfaces_and_opposite_sides_do_not_mix():
    residual = np.where(np.arange(K) % 2, 1.0, -1.0)[None]
    other = (np.arange(K) % 2).astype(np.int32)
    for normals, interface in ((UP, other), (UP * np.where(other, 1.0, -1.0)[:, None], ONE)):
        mean, _ = local_mean(POINTS, normals, interface, residual, np.eye(K))
        np.testing.assert_allclose(mean, residual, rtol=1e-12)
    mixed, _ = local_mean(POINTS, UP, ONE, residual, np.eye(K))
    assert np.abs(mixed[0, 10:-10]).max() < 0.01


def test_rejects_invalid_values():
    with pytest.raises(InputError, match="covariance"):
        local_mean(POINTS, UP, ONE, np.zeros((2, K)), np.eye(K))
    with pytest.raises(InputError, match="length > 0"):
        local_mean(POINTS, UP, ONE, np.zeros((1, K)), np.eye(K), length_mm=0.0)
