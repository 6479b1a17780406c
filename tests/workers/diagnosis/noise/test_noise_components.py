"""Smooth covariances, and the sum of the components of the noise."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.noise.noise_components import (
    LearntNoise,
    smooth_columns,
    smooth_covariance,
)
from tests.workers.diagnosis.linear_world import layout


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


@pytest.mark.parametrize("tolerance", [0.3, 0.05, 1e-6])
def test_columns_neglect_no_more_variance_than_allowed(tolerance):
    size = np.linspace(0.5, 2.0, 120)
    U = smooth_columns(*layout(60), size, 20.0, 0.8, tolerance)
    left = smooth_covariance(*layout(60), 20.0, 0.8) - U @ U.T / np.outer(size, size)
    assert np.linalg.eigvalsh(left).min() > -1e-9
    assert np.diag(left).max() < tolerance
    assert U.shape[1] <= 120


def noise():
    rng = np.random.default_rng(91)
    groups = np.array([0, 1, 0, 1], np.int32)
    stated = np.where(groups[:, None] == groups, 0.3, 0.0) + np.eye(4)
    return LearntNoise(
        stated,
        groups,
        rng.standard_normal((4, 2)),
        rng.standard_normal((4, 3)),
        np.array([0.5, 2.0]),
    )


def test_only_the_segmentation_is_scaled():
    found = noise()
    S = np.diag([0.5, 2.0, 0.5, 2.0])
    scatter = S @ found.stated @ S + found.numerical @ found.numerical.T
    assert found.scatter == pytest.approx(scatter)
    assert found.covariance == pytest.approx(scatter + found.fixed @ found.fixed.T)


@pytest.mark.parametrize("part", ["stated", "fixed", "numerical"])
def test_rejects_invalid_input(part):
    with pytest.raises(InputError, match="The noise of 4 residuals needs"):
        replace(noise(), **{part: getattr(noise(), part)[1:]})
