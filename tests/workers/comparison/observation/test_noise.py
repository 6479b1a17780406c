"""The algebra of the noise model, and comparison with volumes perturbed according to it."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    interface_points,
    observe,
    residual,
)
from palpate.workers.comparison.observation.segmentation_noise import (
    SegmentationNoise,
    correlation,
    covariance,
    noise_from_repeat,
)
from tests.workers.comparison.observation.ellipsoids import breast
from tests.workers.comparison.observation.redrawn import perturbed

BOTH = (OUTLINE, GLANDULAR)
NOISE = SegmentationNoise(sd_mm=0.3, correlation_mm=4.0, reference_sd_mm=0.2, nugget_mm=0.04)


@pytest.fixture(scope="module")
def labels():
    return breast()


@pytest.fixture(scope="module")
def points(labels):
    return interface_points(labels, BOTH, 2.5, 2.0)


@pytest.fixture(scope="module")
def replicates(labels, points):
    return np.array(
        [
            residual(
                points.points, points, observe(perturbed(labels, NOISE, seed), BOTH, band_mm=4.0)
            )[0]
            for seed in range(24)
        ]
    )


@pytest.mark.slow
def test_replicates_have_the_covariance_of_the_model(points, replicates):
    model = covariance(points, SegmentationNoise(0.3, 4.0, 0.0, NOISE.nugget_mm), 1)
    assert abs(replicates.mean()) < 0.02
    for number in range(2):
        own = points.interface == number
        sd = np.sqrt(np.mean(replicates[:, own] ** 2))
        assert sd == pytest.approx(np.sqrt(model[0, 0]), rel=0.1)
    sample = replicates.T @ replicates / len(replicates) / np.mean(replicates**2)
    same = points.interface[:, None] == points.interface
    apart = cdist(points.points, points.points)
    for h in (2.5, 4.0, 6.0, 8.0, 12.0):
        pairs = same & (np.abs(apart - h) < 0.4)
        assert sample[pairs].mean() == pytest.approx(model[pairs].mean() / model[0, 0], abs=0.1)
    assert abs(sample[~same].mean()) < 0.03


def test_noise_is_estimated_from_two_segmentations(labels):
    noise = [
        noise_from_repeat(
            perturbed(labels, NOISE, 100 + n), perturbed(labels, NOISE, 200 + n), wall_margin_mm=2.0
        )
        for n in range(4)
    ]
    assert np.mean([n.sd_mm for n in noise]) == pytest.approx(0.3, rel=0.1)
    assert np.mean([n.correlation_mm for n in noise]) == pytest.approx(4.0, rel=0.1)
    assert max(n.nugget_mm for n in noise) < 0.06
    assert all(n.reference_sd_mm == n.sd_mm for n in noise)


def test_a_different_correlation_length_is_estimated(labels):
    noise = SegmentationNoise(0.2, 2.5, 0.2, 0.02)
    computed = noise_from_repeat(
        perturbed(labels, noise, 1), perturbed(labels, noise, 2), wall_margin_mm=2.0
    )
    assert computed.sd_mm == pytest.approx(0.2, rel=0.15)
    assert computed.correlation_mm == pytest.approx(2.5, rel=0.2)


def test_common_offset_is_not_noise(labels):
    larger = breast(outer=(22.5, 17.5, 14.5), glands=(((11.5, 9.5, 7.5), (0, 0, 0)),))
    noise = noise_from_repeat(labels, larger, wall_margin_mm=2.0)
    assert np.hypot(noise.sd_mm, noise.nugget_mm) < 0.07


def test_states_share_the_reference_noise(points):
    k = len(points)
    matrix = covariance(points, NOISE, 3).reshape(3, k, 3, k)
    smooth = correlation(points, 4.0)
    np.testing.assert_allclose(matrix[0, :, 2], 0.04 * smooth)
    np.testing.assert_allclose(matrix[1, :, 1], (0.04 + 0.09) * smooth + 0.04**2 * np.eye(k))
    np.testing.assert_array_equal(smooth[np.ix_(points.interface == 0, points.interface == 1)], 0)
    assert np.all(np.diag(smooth) == pytest.approx(1))


def test_covariance_is_positive_definite_for_dense_points(labels):
    dense = interface_points(labels, (GLANDULAR,), 0.8, 2.0)
    noise = SegmentationNoise(0.3, 6.0, 0.3, 3e-4)
    values = np.linalg.eigvalsh(covariance(dense, noise, 1))
    assert values[0] == pytest.approx(noise.nugget_mm**2, rel=0.01)
    np.linalg.cholesky(covariance(dense, noise, 2))


def test_errors_on_the_two_sides_of_a_sheet_are_independent():
    values = np.zeros((40, 40, 40), np.uint8)
    values[18:22, 5:35, 5:35] = Tissue.GLANDULAR
    points = interface_points(Volume(values, (0.5,) * 3), (GLANDULAR,), 1.5, 0.0)
    smooth = correlation(points, 4.0)
    up, down = points.normals[:, 2] > 0.99, points.normals[:, 2] < -0.99
    assert up.sum() > 30 and down.sum() > 30
    assert smooth[np.ix_(up, down)].max() < 0.01
    assert smooth[np.ix_(up, up)][np.triu_indices(up.sum(), 1)].max() > 0.8


def test_perturbed_segmentation_is_consistent_and_repeatable(labels):
    values = labels.values.copy()
    values[:, :20][values[:, :20] == Tissue.FAT] = Tissue.SKIN
    mixed = Volume(values, labels.spacing_mm, labels.origin_mm)
    redrawn = perturbed(mixed, NOISE, 7)
    np.testing.assert_array_equal(redrawn.values, perturbed(mixed, NOISE, 7).values)
    assert np.any(redrawn.values != perturbed(mixed, NOISE, 8).values)
    assert set(np.unique(redrawn.values)) == set(np.unique(values))
    assert not (redrawn.values[:, 24:] == Tissue.SKIN).any()  # skin stays on its side
    changed = np.mean(redrawn.values != values)
    assert 0.005 < changed < 0.05
    still = perturbed(mixed, SegmentationNoise(0.0, 4.0, 0.0, 0.01), 7)
    assert np.mean(still.values != values) < 0.1 * changed


def test_perturbation_keeps_the_cut_at_the_wall():
    whole = breast()
    values = np.zeros_like(whole.values)
    values[36:] = whole.values[36:]
    redrawn = perturbed(Volume(values, whole.spacing_mm, whole.origin_mm), NOISE, 3).values
    assert not redrawn[:36].any()
    inner = np.linalg.norm(np.argwhere(values[36] > 0) - (41.5, 51.5), axis=1) < 25
    assert (redrawn[36][tuple(np.argwhere(values[36] > 0)[inner].T)] > 0).all()


def test_refuses_invalid_noise():
    for numbers in (
        (-0.1, 4, 0.3, 0.1),
        (0.3, 0, 0.3, 0.1),
        (0.3, 4, 0.3, 0),
        (0.3, 4, np.nan, 0.1),
    ):
        with pytest.raises(InputError, match="Segmentation noise needs"):
            SegmentationNoise(*numbers)
