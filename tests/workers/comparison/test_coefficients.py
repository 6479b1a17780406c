"""The 28 coefficients, compared with values calculated by hand and by brute force."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.similarity_coefficients import (
    COEFFICIENT_NAMES,
    DirectedDistances,
    coefficients,
)
from palpate.workers.comparison.similarity_score import ModifiedHausdorff, Scorer
from palpate.workers.comparison.voxel_set import Metric, voxel_set

GLAND = (Tissue.GLANDULAR,)


def volume(
    mask: NDArray[np.bool_], spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> Volume:
    return Volume(np.where(mask, Tissue.GLANDULAR, 0).astype(np.uint8), spacing)


def blobs(seed: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return two rough, overlapping sets of different sizes."""
    rng = np.random.default_rng(seed)
    z, y, x = np.mgrid[:14, :17, :19]
    near = (x - 8) ** 2 + (y - 8) ** 2 + (z - 7) ** 2 < 36 + 8 * rng.standard_normal(x.shape)
    far = (x - 10) ** 2 + (y - 7) ** 2 + (z - 6) ** 2 < 25 + 8 * rng.standard_normal(x.shape)
    return near, far


def rods() -> tuple[Volume, Volume]:
    """Rods of 4 and 2 voxels, all of them boundary voxels.

    ::

        X  # # # # . . . .      distances to Y: 4 3 2 1
        Y  . . . . # # . .      distances to X: 1 2
    """
    x, y = np.zeros((1, 1, 8), bool), np.zeros((1, 1, 8), bool)
    x[0, 0, :4] = y[0, 0, 4:6] = True
    return volume(x), volume(y)


def test_two_rods_match_hand_calculation() -> None:
    found = coefficients(*rods()).by_name
    # By rank, percentiles 50, 75 and 90 of (1 2 3 4) are 2, 3, 4; those of (1 2) are 1, 2, 2.
    both = {"D5": (2, 1), "D9": (3, 2), "D13": (4, 2), "D17": (4, 2), "D21": (2.5, 1.5)}
    for name, (a, b) in both.items():
        first = int(name[1:])
        wanted = [min(a, b), max(a, b), (a + b) / 2, (4 * a + 2 * b) / 6]
        assert [found[f"D{first + j}"] for j in range(4)] == pytest.approx(wanted), name
    assert found["JC"] == found["DC"] == 0.0
    assert found["dV"] == 2.0
    assert found["SM"] == pytest.approx(1.0)
    assert (found["mean_dX"], found["mean_dY"]) == pytest.approx((2.5, 1.5))
    assert (found["std_dX"], found["std_dY"]) == pytest.approx((math.sqrt(1.25), 0.5))


def test_there_are_28_names() -> None:
    assert len(COEFFICIENT_NAMES) == len(set(COEFFICIENT_NAMES)) == 28
    assert tuple(coefficients(*rods()).by_name) == COEFFICIENT_NAMES


@pytest.mark.parametrize("surface", ["boundary", "all"])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 0.5, 2.0)])
@pytest.mark.parametrize("seed", [1, 2])
def test_coefficients_match_a_search_tree(
    surface: str, spacing: tuple[float, float, float], seed: int
) -> None:
    a, b = blobs(seed)

    def points(mask: NDArray[np.bool_], *, skin: bool) -> NDArray[np.float64]:
        if skin:
            mask = mask & ~binary_erosion(mask)
        return np.argwhere(mask)[:, ::-1] * np.asarray(spacing)

    skin = surface == "boundary"
    far_a, far_b = points(a, skin=skin), points(b, skin=skin)
    to_b, to_a = cKDTree(far_b).query(far_a)[0], cKDTree(far_a).query(far_b)[0]
    found = coefficients(volume(a, spacing), volume(b, spacing), GLAND, surface).by_name  # type: ignore[arg-type]
    direct = []
    for d in (to_b, to_a):
        ranked = np.percentile(d, (0, 50, 75, 90, 100), method="inverted_cdf")
        direct.append([*ranked, d.mean()])
    for i, (p, q) in enumerate(zip(*direct, strict=True)):
        weighted = (len(to_b) * p + len(to_a) * q) / (len(to_b) + len(to_a))
        for j, wanted in enumerate((min(p, q), max(p, q), (p + q) / 2, weighted), start=1):
            if i:
                assert found[f"D{4 * i + j}"] == pytest.approx(wanted, abs=1e-12)
    assert found["SM"] == pytest.approx(direct[0][-1] - direct[1][-1])
    assert found["dV"] == pytest.approx((int(a.sum()) - int(b.sum())) * np.prod(spacing))
    whole = cKDTree(points(b, skin=skin))
    surface_a = whole.query(points(a, skin=True))[0]
    assert found["mean_dX"] == pytest.approx(surface_a.mean())
    assert found["std_dX"] == pytest.approx(surface_a.std(), abs=1e-9)


@pytest.mark.parametrize("surface", ["boundary", "all"])
def test_coefficients_agree_with_the_score_of_the_search(surface: str) -> None:
    a, b = (volume(mask, (0.2, 0.2, 0.2)) for mask in blobs(3))
    found = coefficients(a, b, GLAND, surface)  # type: ignore[arg-type]
    score = Scorer(b, GLAND, surface).score(a)  # type: ignore[arg-type]
    assert (found.jc, found.dc) == (score.jc, score.dice)
    assert found.mhd_mm == pytest.approx(score.mhd_mm, rel=1e-14)
    assert found.gsf == pytest.approx(score.gsf, rel=1e-12)
    metric = Metric.of_spacing(b.spacing_mm)
    target = ModifiedHausdorff(voxel_set(b, GLAND, b), metric, boundary=surface == "boundary")
    assert found.mhd_mm == pytest.approx(target.distance_mm(voxel_set(a, GLAND, b)), rel=1e-14)


def test_swapping_the_sets_reverses_directed_coefficients() -> None:
    a, b = (volume(mask) for mask in blobs(4))
    forth, back = coefficients(a, b), coefficients(b, a)
    assert forth.hausdorff_mm == pytest.approx(back.hausdorff_mm)
    assert forth.signed_mean_mm == pytest.approx(-back.signed_mean_mm)
    assert forth.volume_difference_mm3 == -back.volume_difference_mm3
    assert (forth.mean_to_y_mm, forth.sd_to_y_mm) == (back.mean_to_x_mm, back.sd_to_x_mm)


def test_identical_sets_have_perfect_coefficients() -> None:
    a, _ = blobs(5)
    found = coefficients(volume(a), volume(a))
    names = found.by_name
    assert (names.pop("JC"), names.pop("DC")) == (1.0, 1.0)
    assert set(names.values()) == {0.0}
    assert found.gsf == -math.inf


@pytest.mark.parametrize(
    ("percent", "wanted"), [(0, 0.0), (50, 0.0), (60, 0.0), (61, 2.0), (80, 2.0), (100, 6.0)]
)
def test_percentiles_count_the_voxels_at_distance_zero(percent: int, wanted: float) -> None:
    # Three voxels at distance 0, one at 1 and one at 3 units of 2 mm.
    distances = DirectedDistances(np.array([1, 9]), 5, 2.0)
    assert distances.percentile_mm(percent) == wanted


def test_refuses_empty_set() -> None:
    a, _ = blobs(6)
    with pytest.raises(InputError, match="no glandular voxel"):
        coefficients(volume(np.zeros_like(a)), volume(a))
    with pytest.raises(InputError, match="'boundary' or 'all'"):
        coefficients(volume(a), volume(a), GLAND, "skin")  # type: ignore[arg-type]
