"""Signed distances, compared with spheres, slabs and every triangle of a surface."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.observation.interface_residual import signed_distance
from palpate.workers.comparison.observation.isosurface import cubic_at_points, surface
from palpate.workers.comparison.observation.triangle_distance import NEAR, distances
from tests.workers.comparison.observation.ellipsoids import breast, lattice

FAT = (Tissue.FAT,)


def sphere(radius, centre=(0.21, -0.34, 0.12)):
    x, y, z, origin = lattice((2 * radius + 16,) * 3, (1.0,) * 3)
    r = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)
    return Volume((r < radius).astype(np.uint8), (1.0,) * 3, origin), r - radius


@pytest.mark.parametrize("radius", [6, 10, 20, 35])
def test_spheres_are_located_within_a_voxel(radius):
    labels, exact = sphere(radius)
    error = (signed_distance(labels, FAT).values - exact)[np.abs(exact) < 5]
    assert abs(error.mean()) < 0.02
    assert np.abs(error).mean() < 0.05
    # Labels do not locate the sphere within a voxel where it is parallel to the grid.
    assert np.quantile(np.abs(error), 0.99) < 0.25
    assert np.abs(error).max() < 0.5


def test_plain_gaussian_shrinks_spheres():
    # The bias that the two Gaussians remove: s^2 / R = 0.225 at s = 1.5, R = 10.
    labels, exact = sphere(10)
    plain = gaussian_filter((labels.values > 0).astype(float), 1.5)
    shell = np.abs(plain - 0.5) < 0.05
    assert exact[shell].mean() == pytest.approx(-0.225, abs=0.03)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.4, 0.7, 1.1)])
def test_distance_to_a_slab_is_exact(spacing):
    values = np.zeros((30, 28, 26), np.uint8)
    values[:, 8:20] = Tissue.FAT  # open towards the faces of the box along x and z
    distance_field = signed_distance(Volume(values, spacing, (3.0, -2.0, 5.0)), FAT)
    y = np.arange(28)
    exact = spacing[1] * np.maximum(7.5 - y, y - 19.5)
    assert np.abs(distance_field.values - exact[:, None]).max() < 1e-3
    points = np.array([(6.0, -2.0 + 20.2 * spacing[1], 12.0)])
    distance, gradient = distance_field.at(points)
    assert distance[0] == pytest.approx(0.7 * spacing[1], abs=1e-3)
    np.testing.assert_allclose(gradient, [(0, 1, 0)], atol=2e-3)


def test_cut_through_tissue_is_not_an_interface():
    values = np.zeros((20, 20, 20), np.uint8)
    values[:12, 4:16, :] = Tissue.FAT  # cut at both faces along x and at the lowest along z
    interface_surface = surface(Volume(values, (1.0,) * 3), FAT)
    normal = np.abs(interface_surface.normals())
    assert normal[:, 0].max() < 1e-5
    assert interface_surface.vertices[interface_surface.normals()[:, 2] > 0.9][
        :, 2
    ] == pytest.approx(11.5, abs=0.3)
    assert not (interface_surface.normals()[:, 2] < -0.1).any()


def test_distances_match_brute_force_over_triangles():
    labels = breast(shape=(52, 42, 36), spacing_mm=(1.0, 0.9, 1.1))
    drawn = surface(labels, (Tissue.GLANDULAR,))
    step = np.asarray(labels.spacing_mm)
    vertices = drawn.vertices - np.asarray(labels.origin_mm)
    distance = distances(vertices, drawn.triangles, labels.values.shape, step, 100.0)
    # A fan of points on each triangle; between them, the distance is at most h^2 / 8d smaller.
    u, v = (w.ravel() for w in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
    weight = np.column_stack([u, v, 1 - u - v])[u + v <= 1 + 1e-9]
    cloud = np.einsum("wc,tcx->twx", weight, vertices[drawn.triangles]).reshape(-1, 3)
    grid = np.argwhere(np.ones(labels.values.shape, bool))[::17]
    brute, _ = KDTree(cloud).query(grid[:, ::-1] * step)
    mine = distance[tuple(grid.T)]
    near = brute < NEAR * step.min()
    assert np.all(mine > brute - 0.01)
    # A vertex passed on by neighbours is occasionally the second nearest.
    assert (mine - brute)[near].max() < 0.08 and (mine - brute).max() < 0.16
    assert np.abs(mine - brute)[near].mean() < 0.004


def test_gradient_is_the_derivative_of_the_value():
    distance_field = signed_distance(breast(), (Tissue.GLANDULAR,), band_mm=12.0)
    points = np.random.default_rng(1).uniform(-32, 32, (400, 3))  # many outside the box
    distance, gradient = distance_field.at(points)
    assert np.isfinite(distance).all() and np.isfinite(gradient).all()
    step = 1e-5
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        slope = (distance_field.at(points + shift)[0] - distance_field.at(points - shift)[0]) / (
            2 * step
        )
        np.testing.assert_allclose(gradient[:, axis], slope, atol=1e-4)


def test_distance_to_the_box_is_added_outside():
    distance_field = signed_distance(breast(), (Tissue.FAT, Tissue.GLANDULAR))
    corner = np.array(distance_field.origin_mm)
    at_corner, _ = distance_field.at(corner[None])
    distance, gradient = distance_field.at((corner - (3.0, 4.0, 12.0))[None])
    assert distance[0] == pytest.approx(at_corner[0] + 13)
    np.testing.assert_allclose(gradient, [(-3 / 13, -4 / 13, -12 / 13)])


def test_distances_are_clipped_at_the_band():
    distance_field = signed_distance(breast(), (Tissue.GLANDULAR,), band_mm=3.0).values
    assert (distance_field.min(), distance_field.max()) == (-3.0, 3.0)
    wide = signed_distance(breast(), (Tissue.GLANDULAR,)).values
    assert np.mean(np.abs(distance_field - np.clip(wide, -3, 3)) > 1e-5) < 1e-4


def test_cubic_convolution_is_exact_for_quadratics():
    spacing, origin = (0.5, 0.8, 1.2), (1.0, -3.0, 2.0)
    z, y, x = np.meshgrid(*(np.arange(n, dtype=float) for n in (9, 10, 11)), indexing="ij")
    x, y, z = (o + h * w for o, h, w in zip(origin, spacing, (x, y, z), strict=True))

    def field(x, y, z):
        return x**2 - 0.5 * y * z + 3 * z**2 + x - 2

    inner = np.random.default_rng(0).uniform(1.001, 7, (50, 3)) * spacing + origin
    value, gradient = cubic_at_points(field(x, y, z).astype(np.float32), spacing, origin, inner)
    px, py, pz = inner.T
    np.testing.assert_allclose(value, field(px, py, pz), atol=1e-3)
    exact = np.column_stack([2 * px + 1, -0.5 * pz, -0.5 * py + 6 * pz])
    np.testing.assert_allclose(gradient, exact, atol=1e-3)


def test_refuses_tissue_without_an_interface():
    labels = breast()
    with pytest.raises(InputError, match="no voxel of muscle"):
        signed_distance(labels, (Tissue.MUSCLE,))
    with pytest.raises(InputError, match="fills the volume"):
        signed_distance(Volume(np.ones((9, 9, 9), np.uint8), (1.0,) * 3), FAT)
    with pytest.raises(InputError, match="band"):
        signed_distance(labels, FAT, band_mm=0)
    with pytest.raises(InputError, match="blur"):
        signed_distance(labels, FAT, smooth_voxels=-1)
    with pytest.raises(InputError, match="not finite"):
        signed_distance(labels, FAT).at(np.array([(0.0, np.nan, 0.0)]))
