"""Smoothing of a rough outline, which preserves the size of the body."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.observation.interface_residual import OUTLINE, signed_distance
from palpate.workers.comparison.observation.isosurface import smooth_outline
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from tests.workers.comparison.observation.redrawn import perturbed

HALF = (30.0, 24.0, 26.0)


def half_ellipsoid() -> Volume:
    x, y, z = np.arange(-36, 36.1, 1.0), np.arange(-30, 30.1, 1.0), np.arange(0.5, 32, 1.0)
    r = (x / HALF[0]) ** 2 + (y[:, None] / HALF[1]) ** 2 + (z[:, None, None] / HALF[2]) ** 2
    gland = r < 0.2
    labels = np.where(r < 1, np.where(gland, Tissue.GLANDULAR, Tissue.FAT), Tissue.AIR)
    return Volume(labels.astype(np.uint8), (1.0, 1.0, 1.0), (-36.0, -30.0, 0.5))


def on_surface(count: int = 400) -> np.ndarray:
    rng = np.random.default_rng(3)
    direction = rng.standard_normal((count, 3))
    direction[:, 2] = np.abs(direction[:, 2]) + 0.15
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return direction * np.asarray(HALF) / np.linalg.norm(direction, axis=1)[:, None]


def error_mm(labels: Volume) -> np.ndarray:
    points = on_surface()
    points /= np.sqrt(((points / np.asarray(HALF)) ** 2).sum(axis=1))[:, None]
    return signed_distance(labels, OUTLINE.inside).at(points)[0]


def test_smooth_outline_is_unchanged() -> None:
    before, after = half_ellipsoid(), smooth_outline(half_ellipsoid(), 4.0)
    assert abs(error_mm(after).mean()) < 0.08
    ratio = np.count_nonzero(after.values) / np.count_nonzero(before.values)
    assert ratio == pytest.approx(1, abs=0.01)
    gland = [np.count_nonzero(v.values == Tissue.GLANDULAR) for v in (before, after)]
    assert gland[0] == gland[1]


def test_roughness_is_removed() -> None:
    rough = perturbed(half_ellipsoid(), SegmentationNoise(0.6, 4.0, 0.0, 0.05), seed=2)
    before, after = error_mm(rough), error_mm(smooth_outline(rough, 4.0))
    assert before.std() > 0.4
    assert after.std() < 0.75 * before.std()
    assert abs(after.mean()) < 0.15


@pytest.mark.parametrize("axis", [0, 1])
def test_wave_is_damped_like_the_difference_of_gaussians(axis) -> None:
    r"""A top face z = h + a sin(k s) along one axis s, k = 2 pi / w, on voxels of three lengths.

    A low wave moves the level by its filtered height: near a plane, g_s has the density 1 / s and
    g_2s half of it, so ``2 g_s - g_2s`` leaves the fraction ``(4 exp(-k^2 s^2 / 2) - exp(-2 k^2
    s^2)) / 3`` of the height, in phase. A slope across the wave spreads the heights over fractions
    of a voxel.
    """
    spacing, length, height, wave = (0.5, 1.0, 0.4), 2.5, 0.6, 10.0
    k = 2 * np.pi / wave
    low = np.array([-35.0, -35.0, 0.2])
    x = low[0] + spacing[0] * np.arange(141)
    y = low[1] + spacing[1] * np.arange(71)
    z = low[2] + spacing[2] * np.arange(70)
    along, across = (x, y[:, None]) if axis == 0 else (y[:, None], x)
    top = 22.0 + height * np.sin(k * along) + 0.05 * across
    labels = np.where(z[:, None, None] < top, Tissue.FAT, Tissue.AIR).astype(np.uint8)
    after = smooth_outline(Volume(labels, spacing, tuple(low)), length)

    nx, ny, _ = after.shape_xyz
    x = after.origin_mm[0] + spacing[0] * np.arange(nx)
    y = (after.origin_mm[1] + spacing[1] * np.arange(ny))[:, None]
    heights = spacing[2] * np.count_nonzero(after.values, axis=0)
    along, across = (x, y) if axis == 0 else (y, x)
    middle = np.broadcast_to((np.abs(along) < wave) & (np.abs(across) < 15), heights.shape)
    terms = [np.sin(k * along), np.cos(k * along), np.ones_like(along), across]
    columns = np.stack([np.broadcast_to(t, heights.shape)[middle] for t in terms], axis=1)
    sine, cosine, _, slope = np.linalg.lstsq(columns, heights[middle], rcond=None)[0]
    left = (4 * np.exp(-0.5 * (k * length) ** 2) - np.exp(-2 * (k * length) ** 2)) / 3
    assert sine == pytest.approx(left * height, abs=0.01)
    assert cosine == pytest.approx(0, abs=0.01)
    assert slope == pytest.approx(0.05, abs=0.01)


def test_refuses_nonpositive_length() -> None:
    with pytest.raises(InputError, match="must be > 0 mm"):
        smooth_outline(half_ellipsoid(), 0.0)
