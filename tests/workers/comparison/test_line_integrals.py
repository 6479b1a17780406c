"""Path lengths of rays in voxel bodies, compared with closed forms and with sampling."""

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.comparison.xray_beam import (
    CC_AXIS,
    Geometry,
    Unit,
    geometry_of,
    mlo_axis,
    path_lengths_mm,
)

COARSE = Unit(pixel_mm=2.0)


def body_of(inside: NDArray[np.bool_], voxel_mm: float, start: float) -> Volume:
    values = np.where(inside, Tissue.GLANDULAR, Tissue.AIR).astype(np.uint8)
    return Volume(values, (voxel_mm,) * 3, (start, start, start))


def ellipsoid(half_mm: tuple[float, float, float], voxel_mm: float) -> Volume:
    """Return the voxels whose centres are in an ellipsoid about the origin."""
    n = 2 * int(np.ceil(max(half_mm) / voxel_mm) + 1)
    at = (np.arange(n) - (n - 1) / 2) * voxel_mm
    a, b, c = half_mm
    rim = (at[None, None, :] / a) ** 2 + (at[None, :, None] / b) ** 2 + (at[:, None, None] / c) ** 2
    return body_of(rim <= 1, voxel_mm, float(at[0]))


def ellipsoid_chords(half_mm: tuple[float, float, float], geometry: Geometry) -> FloatArray:
    """Return the length of |s + t w| <= 1 in units of the half axes."""
    ray = geometry.pixels_mm - geometry.source_mm
    s, w = geometry.source_mm / half_mm, ray / half_mm
    a, b, c = (w * w).sum(-1), w @ s, s @ s - 1
    root = np.sqrt(np.maximum(b * b - a * c, 0))
    return np.asarray(2 * root / a * np.linalg.norm(ray, axis=-1))


def box_chords(low: FloatArray, high: FloatArray, geometry: Geometry) -> FloatArray:
    """Return the length between the faces of a box (slab method)."""
    ray = geometry.pixels_mm - geometry.source_mm
    with np.errstate(divide="ignore"):
        a, b = (low - geometry.source_mm) / ray, (high - geometry.source_mm) / ray
    enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    return np.asarray(np.maximum(leave - enter, 0) * np.linalg.norm(ray, axis=-1))


@pytest.mark.parametrize("axis", [CC_AXIS, mlo_axis(45.0), mlo_axis(-30.0)])
def test_path_lengths_in_a_block_of_voxels_are_exact(axis: tuple[float, float, float]) -> None:
    spacing = (1.0, 0.7, 1.3)
    values = np.full((30, 40, 50), Tissue.FAT, np.uint8)
    values[:, 10:25, 5:20] = Tissue.GLANDULAR
    body = Volume(values, spacing, (-24.5, 3.0, 0.65))
    geometry = geometry_of(body, axis, COARSE)
    lengths = path_lengths_mm(body, geometry)
    corner = np.asarray(body.origin_mm) - 0.5 * np.asarray(spacing)
    whole = box_chords(corner, corner + np.array([50, 40, 30]) * spacing, geometry)
    part = np.array([[5, 10, 0], [20, 25, 30]]) * spacing + corner
    gland = box_chords(part[0], part[1], geometry)
    assert whole.max() > 20
    np.testing.assert_allclose(lengths.sum(-1), whole, atol=2e-5)
    np.testing.assert_allclose(lengths[..., Tissue.GLANDULAR], gland, atol=2e-5)


@pytest.mark.parametrize("half", [(20.0, 20.0, 20.0), (30.0, 12.0, 20.0)])
@pytest.mark.parametrize("axis", [CC_AXIS, mlo_axis()])
def test_path_lengths_in_ellipsoids_converge(
    half: tuple[float, float, float], axis: tuple[float, float, float]
) -> None:
    voxels = (2.0, 1.0, 0.5)
    geometry = geometry_of(ellipsoid(half, 1.0), axis, Unit(pixel_mm=1.0))
    exact = ellipsoid_chords(half, geometry)
    errors = []
    for voxel in voxels:
        found = path_lengths_mm(ellipsoid(half, voxel), geometry)[..., Tissue.GLANDULAR]
        errors.append(float(np.abs(found - exact).mean()))
        # The staircase is off by about a voxel per ray, without bias.
        assert abs(float((found - exact).sum() / exact.sum())) < 0.02 * voxel
    order = np.polyfit(np.log(voxels), np.log(errors), 1)[0]
    assert order > 0.95
    assert errors[-1] < 0.5 * voxels[-1]


def test_path_lengths_match_sampling_of_random_voxels() -> None:
    rng = np.random.default_rng(5)
    body = Volume(rng.integers(0, 6, (9, 11, 13)).astype(np.uint8), (1.5, 1.0, 2.0), (-9, 2, 1))
    geometry = geometry_of(body, mlo_axis(20.0), Unit(120.0, 5.0, 3.0))
    lengths = path_lengths_mm(body, geometry)
    steps = 40_000
    part = (np.arange(steps) + 0.5) / steps
    corner = np.asarray(body.origin_mm) - 0.5 * np.asarray(body.spacing_mm)
    for row, column in ((2, 1), (5, 3), (8, 0)):
        ray = geometry.pixels_mm[row, column] - geometry.source_mm
        at = (geometry.source_mm + part[:, None] * ray - corner) / body.spacing_mm
        i, j, k = np.floor(at).astype(int).T
        inside = (at >= 0).all(1) & (i < 13) & (j < 11) & (k < 9)
        count = np.bincount(body.values[k[inside], j[inside], i[inside]], minlength=6)
        wanted = count * np.linalg.norm(ray) / steps
        assert wanted.sum() > 4
        np.testing.assert_allclose(lengths[row, column], wanted, atol=0.02)


def test_shadow_is_magnified_and_ends_at_the_wall() -> None:
    body = Volume(np.ones((20, 10, 30), np.uint8), (1.0, 1.0, 1.0), (-14.5, 0.5, 0.5))
    unit = Unit(source_mm=600.0, gap_mm=100.0, pixel_mm=0.25)
    geometry = geometry_of(body, CC_AXIS, unit)
    shadow = path_lengths_mm(body, geometry)[..., Tissue.FAT] > 0
    # The top of the body, 110 mm above the detector, is magnified by 600 / 490.
    assert shadow.any(axis=1).sum() * 0.25 == pytest.approx(30 * 600 / 490, abs=0.5)
    assert shadow.any(axis=0).sum() * 0.25 == pytest.approx(20 * 600 / 490, abs=0.25)
    # The focal spot is above the wall: the rays of the first column cross the whole height there.
    assert shadow[:, 0].any()
    assert geometry.pixels_mm[..., 2].min() == pytest.approx(0.125)


def test_oblique_view_equals_upright_view_of_a_rotated_body() -> None:
    half = (15.0, 15.0, 10.0)
    upright = geometry_of(ellipsoid(half, 0.5), CC_AXIS, COARSE, support_mm=-15.0)
    oblique = geometry_of(ellipsoid(half, 0.5), mlo_axis(), COARSE, support_mm=-15.0)
    rows, columns = (min(getattr(g, n) for g in (upright, oblique)) for n in ("rows", "columns"))
    a, b = ellipsoid_chords(half, upright), ellipsoid_chords(half, oblique)
    middle = [slice(g.rows // 2 - rows // 2, g.rows // 2 + rows // 2) for g in (upright, oblique)]
    np.testing.assert_allclose(a[middle[0], :columns], b[middle[1], :columns], atol=1e-9)


def test_refuses_invalid_input() -> None:
    body = Volume(np.ones((4, 4, 4), np.uint8), (1.0, 1.0, 1.0))
    with pytest.raises(InputError, match="only air"):
        geometry_of(Volume(np.zeros((4, 4, 4), np.uint8), (1.0, 1.0, 1.0)))
    with pytest.raises(InputError, match="perpendicular to z"):
        geometry_of(body, (0.0, 1.0, 1.0))
    with pytest.raises(InputError, match="beyond the focal spot at"):
        geometry_of(Volume(body.values, (1.0, 1000.0, 1.0)))
    with pytest.raises(InputError, match="pixels > 0"):
        Unit(pixel_mm=0.0)
    geometry = geometry_of(body)
    with pytest.raises(InputError, match="labels must be whole numbers"):
        path_lengths_mm(Volume(body.values * 7, (1.0, 1.0, 1.0)), geometry)
