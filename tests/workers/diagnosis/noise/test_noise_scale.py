"""The learnt size of the noise, compared with the scales of noise drawn at random."""

import numpy as np
import pytest

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.noise.noise_components import pose_columns, smooth_columns
from palpate.workers.diagnosis.noise.noise_scale import noise_scales
from tests.workers.diagnosis.linear_world import (
    NOISE_MM,
    NUGGET_MM,
    REFERENCE_MM,
    ellipsoid,
    layout,
    mode,
    nominal_problem,
)

K, BODIES = 150, 8
# Every other point belongs to another interface.
GROUPS = np.tile(np.arange(K) % 2, 2).astype(np.int32)


def stated_noise(length_mm):
    """Return the noise of two interfaces in two scans, and at rest, with a correlation length."""
    points, _ = ellipsoid(K)
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    smooth = np.exp(-0.5 * (distance / length_mm) ** 2)
    each = NOISE_MM**2 * smooth + NUGGET_MM**2 * np.eye(K)
    noise = np.kron(np.eye(2), each) + np.kron(np.ones((2, 2)), REFERENCE_MM**2 * smooth)
    return noise * (GROUPS[:, None] == GROUPS)


def explanations():
    """Return the columns of constants, poses and an almost free smooth field."""
    points, normals = ellipsoid(K)
    problem = nominal_problem(K)
    poses = pose_columns([points] * 2, [normals] * 2, (0.0, 0.0, 0.0), 0.3, 0.3)
    amplitude, length = SETTINGS.noise.learning_field
    field = smooth_columns(*layout(K), np.full(2 * K, amplitude), length, 0.8, 0.05)
    return np.hstack([problem.nominal * problem.nominal_sd, poses, field])


def hat_of(stated, columns, scales):
    """Return the whitened residuals' map I - H, for noise of the given scales, (m, m)."""
    s = np.asarray(scales)[GROUPS]
    A = np.linalg.solve(np.linalg.cholesky(stated * s[:, None] * s), columns)
    return np.eye(2 * K) - A @ np.linalg.solve(np.eye(A.shape[1]) + A.T @ A, A.T)


def learnt(stated, columns, scales, rng, smooth_gap=0.0):
    s = np.asarray(scales)[GROUPS]
    drawn = np.linalg.cholesky(stated * s[:, None] * s) @ rng.standard_normal(2 * K)
    return noise_scales(stated, GROUPS, columns, drawn + smooth_gap)


@pytest.mark.parametrize("length_mm", [0.1, 6.0])
@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.5, 2.0), (1.6, 0.7)])
def test_recovers_the_scales_of_two_interfaces(scales, length_mm):
    """Means over bodies, and single bodies, scatter as expected from the degrees of freedom."""
    rng = np.random.default_rng(81)
    stated, columns = stated_noise(length_mm), explanations()
    left = np.diag(np.linalg.matrix_power(hat_of(stated, columns, scales), 2))
    sd = np.array(scales) / np.sqrt(2 * np.bincount(GROUPS, left))
    found = np.array([learnt(stated, columns, scales, rng) for _ in range(BODIES)])
    assert (np.abs(found - scales) < 4 * sd).all()
    assert (np.abs(found.mean(axis=0) - scales) < 3 * sd / np.sqrt(BODIES)).all()


@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.6, 1.5)])
def test_a_strong_smooth_gap_is_not_learnt_as_noise(scales):
    """The gap is four times as large as the noise."""
    rng = np.random.default_rng(82)
    stated, columns = stated_noise(6.0), explanations()
    gap = mode(K, (1, 1, 0), 2, 1.0)
    left = np.diag(np.linalg.matrix_power(hat_of(stated, columns, scales), 2))
    sd = np.array(scales) / np.sqrt(2 * np.bincount(GROUPS, left))
    found = np.array([learnt(stated, columns, scales, rng, gap) for _ in range(BODIES)])
    assert (np.abs(found.mean(axis=0) - scales) < 3 * sd).all()
    alone = noise_scales(stated, GROUPS, columns[:, :3], gap)
    assert (alone > 2.0).all()


def test_scales_are_the_fixed_point_with_dense_matrices():
    stated, columns = stated_noise(6.0), explanations()
    residual = np.linalg.cholesky(stated) @ np.random.default_rng(83).standard_normal(2 * K)
    found = noise_scales(stated, GROUPS, columns, residual)
    s = found[GROUPS]
    hat = hat_of(stated, columns, found)
    e = hat @ np.linalg.solve(np.linalg.cholesky(stated * s[:, None] * s), residual)
    left = np.diag(hat @ hat)
    ratio = np.bincount(GROUPS, e**2) / np.bincount(GROUPS, left)
    assert ratio == pytest.approx(np.ones(2), abs=0.02)


def test_scales_have_bounds():
    stated, columns = stated_noise(6.0), np.zeros((2 * K, 0))
    residual = np.linalg.cholesky(stated) @ np.random.default_rng(84).standard_normal(2 * K)
    low, high = SETTINGS.noise.scale_bounds
    ends = np.where(GROUPS, 1e3, 1e-3) * residual
    assert noise_scales(stated, GROUPS, columns, ends).tolist() == [low, high]
