"""A rough body becomes smooth and stays as large."""

import numpy as np
import pytest
from redrawn import perturbed

from storage.errors import InputError
from storage.values import Tissue, Volume
from workers.observation.distance import signed_distance
from workers.observation.interface import OUTLINE
from workers.observation.noise import SegmentationNoise
from workers.observation.smooth_outline import smooth_outline

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


def test_a_smooth_body_stays_as_it_is() -> None:
    before, after = half_ellipsoid(), smooth_outline(half_ellipsoid(), 4.0)
    assert abs(error_mm(after).mean()) < 0.08
    ratio = np.count_nonzero(after.values) / np.count_nonzero(before.values)
    assert ratio == pytest.approx(1, abs=0.01)
    gland = [np.count_nonzero(v.values == Tissue.GLANDULAR) for v in (before, after)]
    assert gland[0] == gland[1]


def test_roughness_goes() -> None:
    rough = perturbed(half_ellipsoid(), SegmentationNoise(0.6, 4.0, 0.0, 0.05), seed=2)
    before, after = error_mm(rough), error_mm(smooth_outline(rough, 4.0))
    assert before.std() > 0.4
    assert after.std() < 0.75 * before.std()
    assert abs(after.mean()) < 0.15


def test_a_length_is_positive() -> None:
    with pytest.raises(InputError, match="length > 0"):
        smooth_outline(half_ellipsoid(), 0.0)
