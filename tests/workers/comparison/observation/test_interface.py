"""Points on the interfaces of ellipsoids."""

from dataclasses import fields

import numpy as np
import pytest
from scipy.spatial import KDTree

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    interface_points,
)
from tests.workers.comparison.observation.ellipsoids import area, breast, normals, offsets

BOTH = (OUTLINE, GLANDULAR)
OUTER, INNER = (22.0, 17.0, 14.0), (11.0, 9.0, 7.0)
TWO = (((5.0, 6.0, 7.0), (-9.0, 0.0, 0.0)), ((4.0, 5.0, 6.0), (8.0, 0.0, 1.0)))


@pytest.fixture(scope="module")
def points():
    return interface_points(breast(), BOTH, spacing_mm=1.5, wall_margin_mm=0.0)


@pytest.mark.parametrize(("number", "half_axes"), [(0, OUTER), (1, INNER)])
def test_points_are_on_the_ellipsoid_with_outward_normals(points, number, half_axes):
    own = points.interface == number
    off = offsets(points.points[own], half_axes) / 0.5  # in voxels
    assert abs(off.mean()) < 0.02
    assert np.abs(off).mean() < 0.05
    assert np.quantile(np.abs(off), 0.9) < 0.1
    assert np.abs(off).max() < 0.45  # where the ellipsoid is parallel to the grid
    np.testing.assert_allclose(np.linalg.norm(points.normals, axis=1), 1)
    angle = np.degrees(
        np.arccos(np.sum(points.normals[own] * normals(points.points[own], half_axes), axis=1))
    )
    assert angle.mean() < 3.5 and angle.max() < 15


@pytest.mark.parametrize(("number", "half_axes"), [(0, OUTER), (1, INNER)])
def test_areas_sum_to_the_area_of_the_ellipsoid(points, number, half_axes):
    own = points.interface == number
    exact = area(half_axes)
    assert points.area_mm2[own].sum() == pytest.approx(exact, rel=0.01)
    assert exact / own.sum() == pytest.approx(1.2 * 1.5**2, rel=0.1)
    assert points.area_mm2[own].std() < 0.35 * points.area_mm2[own].mean()
    nearest = KDTree(points.points[own]).query(points.points[own], k=2)[0][:, 1]
    assert nearest.min() > 0.8 * 1.5 and nearest.max() < 1.7 * 1.5


def test_sparse_points_each_represent_the_square_of_the_spacing():
    points = interface_points(breast(), BOTH, spacing_mm=4.0, wall_margin_mm=0.0)
    assert points.area_mm2.sum() / len(points) == pytest.approx(16.0, rel=0.1)


def test_points_are_repeatable(points):
    again = interface_points(breast(), BOTH, spacing_mm=1.5, wall_margin_mm=0.0)
    for column in fields(points):
        np.testing.assert_array_equal(getattr(points, column.name), getattr(again, column.name))


def test_no_points_near_the_wall_or_on_a_cut():
    whole = breast()
    half = Volume(whole.values[36:], whole.spacing_mm, (*whole.origin_mm[:2], 0.25))
    cut = interface_points(half, BOTH, 1.5, 0.0)  # the box ends at z = 0.25
    assert cut.normals[:, 2].min() > -0.2
    assert cut.area_mm2[cut.interface == 0].sum() == pytest.approx(area(OUTER) / 2, rel=0.03)
    capped = np.pad(half.values, ((6, 0), (0, 0), (0, 0)))  # like a body that ends in air
    labels = Volume(capped, half.spacing_mm, (*half.origin_mm[:2], 0.25 - 6 * 0.5))
    assert (interface_points(labels, (OUTLINE,), 1.5, 0.0).normals[:, 2] < -0.9).any()
    clear = interface_points(labels, BOTH, 1.5, 4.0)
    assert 3.9 < clear.points[:, 2].min() < 5
    assert clear.normals[:, 2].min() > 0.1


def test_each_compartment_is_a_part_but_a_speck_is_not():
    labels = breast(glands=TWO)
    values = labels.values.copy()
    values[36, 20, 52] = values[60, 40:42, 50:52] = Tissue.GLANDULAR
    points = interface_points(Volume(values, labels.spacing_mm, labels.origin_mm), BOTH, 1.5, 0.0)
    assert points.part.max() == 2
    assert np.all(points.part[points.interface == 0] == 0)
    left = points.points[points.part == 1]
    assert left[:, 0].max() < -3.5
    assert points.area_mm2[points.part == 1].sum() == pytest.approx(area(TWO[0][0]), rel=0.02)
    assert points.area_mm2[points.part == 2].sum() == pytest.approx(area(TWO[1][0]), rel=0.02)


def test_clear_points_are_not_on_thin_strands():
    thin = ((9.0, 7.0, 0.7), (0.0, 0.0, 0.25))  # up to 1.4 mm thick
    labels = breast(glands=(TWO[0], thin))
    every = interface_points(labels, (GLANDULAR,), 1.5, 0.0)
    clear = interface_points(labels, (GLANDULAR,), 1.5, 0.0, clear_mm=2.0)
    assert np.sum(every.points[:, 0] > -3) > 50
    assert not np.any(clear.points[:, 0] > -3)
    assert np.sum(clear.points[:, 0] < -10) > 0.9 * np.sum(every.points[:, 0] < -10)


def test_refuses_invalid_requests():
    labels = breast()
    with pytest.raises(InputError, match="spacing > 0 mm"):
        interface_points(labels, BOTH, 0.0, 4.0)
    with pytest.raises(InputError, match="Lower the margin"):
        interface_points(labels, BOTH, 1.5, 60.0)
