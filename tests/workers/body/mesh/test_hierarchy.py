"""Meshes compared with solid geometry and topology."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.body_outline import distance_at, outline_of, skin_thickness_mm
from palpate.workers.body.mesh.mesh_geometry import (
    boundary_triangles,
    measures,
    nodal_areas_mm2,
    split_boundary,
    summarise,
    triangle_areas_mm2,
    volumes_mm3,
)
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy, from_arrays, to_arrays


def assert_sound(level, wall_z_mm=0.0):
    """Check positive tetrahedra with paired faces; one closed, outward, flat-bottomed surface."""
    mesh = level.mesh
    assert mesh.nodes.dtype == np.float64 and mesh.tets.dtype == np.int32
    assert volumes_mm3(mesh).min() > 0
    assert np.array_equal(np.unique(mesh.tets), np.arange(len(mesh.nodes)))
    faces = np.sort(mesh.tets[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3))
    unique, count = np.unique(faces, axis=0, return_counts=True)
    assert set(count) == {1, 2}
    surface = boundary_triangles(mesh.tets)
    assert np.array_equal(np.unique(np.sort(surface), axis=0), unique[count == 1])

    # Every edge is used once in each direction: a closed surface, all of it facing outwards.
    walked = surface[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(np.unique(walked, axis=0)) == len(walked)
    assert {tuple(e) for e in walked} == {tuple(e) for e in walked[:, ::-1]}
    edges = len(walked) // 2
    assert len(np.unique(surface)) - edges + len(surface) == 2  # Euler: a sphere
    x = mesh.nodes[surface]
    flux = np.einsum("ti,ti->", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6
    assert flux == pytest.approx(volumes_mm3(mesh).sum(), rel=1e-9)

    free, wall = split_boundary(surface, level.wall)
    assert np.array_equal(free, level.surface)
    assert mesh.nodes[:, 2].min() == wall_z_mm
    assert np.all(mesh.nodes[level.wall, 2] == wall_z_mm)
    assert np.array_equal(np.flatnonzero(mesh.nodes[:, 2] == wall_z_mm), level.wall)
    assert set(np.unique(wall)) <= set(level.wall)


def test_every_level_is_sound(meshes):
    assert len(meshes.levels[0].mesh.nodes) <= 300
    assert len(meshes.levels) == 3
    for level in meshes.levels:
        assert_sound(level)


@pytest.mark.parametrize("nodes", [2000, 12000])
def test_volume_and_wall_match_the_half_ellipsoid(breast, breast_mm3, nodes):
    level = build_hierarchy(breast, nodes=nodes).finest
    assert len(level.mesh.nodes) == pytest.approx(nodes, rel=0.1)
    assert volumes_mm3(level.mesh).sum() == pytest.approx(breast_mm3, rel=0.01)
    _, wall = split_boundary(boundary_triangles(level.mesh.tets), level.wall)
    wall_mm2 = triangle_areas_mm2(level.mesh.nodes, wall).sum()
    assert wall_mm2 == pytest.approx(np.pi * 85 * 50, rel=0.015)
    areas = nodal_areas_mm2(level.mesh.nodes, level.surface)
    assert areas.sum() == pytest.approx(
        triangle_areas_mm2(level.mesh.nodes, level.surface).sum(), rel=1e-12
    )


def test_surface_follows_the_outline_within_a_voxel(meshes):
    # Distance to the ellipsoid F = 0, F = sum (x/a)^2 - 1, to first order: F / |grad F|.
    semi = np.array([85.0, 50.0, 50.0])
    x = meshes.finest.mesh.nodes[np.unique(meshes.finest.surface)]
    away = (((x / semi) ** 2).sum(axis=1) - 1) / (2 * np.linalg.norm(x / semi**2, axis=1))
    assert np.abs(away).max() < 1.0  # voxels of 2 mm
    assert np.abs(away).mean() < 0.25


def test_no_tetrahedron_is_badly_shaped(meshes):
    for level in meshes.levels:
        summary = summarise(level.mesh)
        assert summary["aspect"]["max"] < 5
        assert summary["M3"]["min"] > 0.5
        assert summary["bad"] == 0
    assert summarise(meshes.finest.mesh)["aspect"]["mean"] < 1.4


def test_element_size_is_the_lattice_cell(breast):
    meshes = build_hierarchy(breast, element_size_mm=8.0)
    assert meshes.element_size_mm == 8.0
    assert np.median(measures(meshes.finest.mesh)["volume_mm3"]) == pytest.approx(8**3 / 12)


def test_levels_coarsen_in_equal_ratios(breast):
    meshes = build_hierarchy(breast, element_size_mm=5.0)
    size = [np.median(measures(m.mesh)["volume_mm3"]) ** (1 / 3) for m in meshes.levels]
    assert len(size) == 3
    assert size[0] / size[1] == pytest.approx(size[1] / size[2], rel=0.25)
    assert 1.5 < size[0] / size[1] < 3
    assert len(meshes.levels[0].mesh.nodes) < 300


def test_anisotropic_voxels_give_the_same_body(make_half_ellipsoid, breast_mm3):
    level = build_hierarchy(make_half_ellipsoid((0.8, 2.0, 3.5)), nodes=3000).finest
    assert_sound(level)
    assert volumes_mm3(level.mesh).sum() == pytest.approx(breast_mm3, rel=0.01)
    extent = level.mesh.nodes.max(axis=0) - level.mesh.nodes.min(axis=0)
    np.testing.assert_allclose(extent, (170, 100, 50), atol=3)


def test_moved_volume_gives_the_same_mesh_moved(breast):
    moved = Volume(breast.values, breast.spacing_mm, (100.0, -20.0, 31.0))
    level = build_hierarchy(moved, element_size_mm=9.0).finest
    assert_sound(level, wall_z_mm=30.0)
    still = build_hierarchy(breast, element_size_mm=9.0).finest
    shift = np.array(moved.origin_mm) - breast.origin_mm
    assert np.array_equal(level.mesh.tets, still.mesh.tets)
    np.testing.assert_allclose(level.mesh.nodes, still.mesh.nodes + shift, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "inside"),
    [
        ("cap", lambda x, y, z: x**2 + y**2 + (z + 60) ** 2 < 85**2),  # sharp rim
        ("undercut", lambda x, y, z: x**2 + y**2 + (z - 20) ** 2 < 45**2),
        ("box", lambda x, y, z: (abs(x) < 60) & (abs(y) < 40) & (z < 50)),
        ("cone", lambda x, y, z: x**2 + y**2 < (60 * (1 - z / 65)) ** 2),
    ],
)
def test_bodies_of_other_shapes_are_sound(make_body, name, inside):
    labels = make_body(inside, (65.0, 65.0), 66.0)
    meshes = build_hierarchy(labels, nodes=2500)
    voxels_mm3 = np.count_nonzero(labels.values) * labels.voxel_mm3
    for level in meshes.levels:
        assert_sound(level)
        assert measures(level.mesh)["aspect"].max() < 8
    assert volumes_mm3(meshes.finest.mesh).sum() == pytest.approx(voxels_mm3, rel=2e-3)


def test_rough_body_has_no_hinges(make_body):
    # Ripples no wider than two cells make parts that touch only along edges.
    wave = np.array([(0.55, 0.1, 0.3), (-0.2, 0.6, 0.15), (0.25, -0.3, 0.5)])

    def inside(x, y, z):
        ripple = sum(np.sin(a * x + b * y + c * z) for a, b, c in wave)
        return x**2 + y**2 + z**2 < (46 + 8 * ripple) ** 2

    level = build_hierarchy(make_body(inside, (65.0, 65.0), 64.0), nodes=2500).finest
    surface = boundary_triangles(level.mesh.tets)
    edges = np.sort(surface[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2))
    assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}
    assert volumes_mm3(level.mesh).min() > 0


def test_largest_body_is_used_and_its_cavity_filled(make_body):
    def inside(x, y, z):
        dome = (x + 30) ** 2 + y**2 + z**2 < 45**2
        crumb = (x - 55) ** 2 + y**2 + (z - 20) ** 2 < 12**2
        below = (abs(x - 55) < 5) & (abs(y) < 5) & (z < 5)
        bubble = (x + 30) ** 2 + y**2 + (z - 20) ** 2 < 9**2
        return (dome & ~bubble & (z > 4)) | crumb | below

    level = build_hierarchy(make_body(inside, (80.0, 50.0), 50.0), nodes=3000).finest
    assert_sound(level, wall_z_mm=4.0)
    dome_mm3 = 2 / 3 * np.pi * 45**3 - np.pi * (45**2 * 4 - 4**3 / 3)
    assert volumes_mm3(level.mesh).sum() == pytest.approx(dome_mm3, rel=0.01)
    assert level.mesh.nodes[:, 0].max() < 16


def test_same_labels_give_the_same_mesh(breast):
    first, second = (to_arrays(build_hierarchy(breast, nodes=1500)) for _ in range(2))
    assert first.keys() == second.keys()
    for name in first:
        assert np.array_equal(first[name], second[name]), name


def test_spatial_neighbours_are_close_in_memory(meshes):
    mesh = meshes.finest.mesh
    spread = np.ptp(mesh.tets, axis=1)
    assert np.median(spread) < 0.1 * len(mesh.nodes)
    assert np.all(np.diff(mesh.tets.min(axis=1)) >= 0)


def test_arrays_survive_a_round_trip(meshes):
    again = from_arrays(to_arrays(meshes))
    assert again.element_size_mm == meshes.element_size_mm
    assert len(again.levels) == len(meshes.levels)
    for old, new in zip(meshes.levels, again.levels, strict=True):
        for name in ("fractions", "wall", "surface"):
            assert np.array_equal(getattr(old, name), getattr(new, name))
        assert np.array_equal(old.mesh.nodes, new.mesh.nodes)
        assert np.array_equal(old.mesh.tets, new.mesh.tets)
        if old.prolongation is None:
            assert new.prolongation is None
        else:
            assert abs(old.prolongation - new.prolongation).max() == 0
    assert again.levels[0].prolongation is None


def test_skin_is_resolved_by_elements_of_its_thickness(make_body):
    # A shell of 6 mm under a half sphere of 45 mm: volume 2/3 pi (45^3 - 39^3) = 6 (1 - 2/15
    # + 4/675) mm times its area.
    labels = make_body(lambda x, y, z: x**2 + y**2 + z**2 < 45**2, (45.0, 45.0), 45.0, (1.5,) * 3)
    core = make_body(lambda x, y, z: x**2 + y**2 + z**2 < 39**2, (45.0, 45.0), 45.0, (1.5,) * 3)
    values = np.where((labels.values > 0) & (core.values == 0), Tissue.SKIN, labels.values)
    skinned = Volume(values.astype(np.uint8), labels.spacing_mm, labels.origin_mm)
    assert skin_thickness_mm(skinned) == pytest.approx(6 * (1 - 2 / 15 + 4 / 675), rel=0.03)
    assert skin_thickness_mm(labels) == 0


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({}, "exactly one"),
        ({"element_size_mm": 5.0, "nodes": 5000}, "exactly one"),
        ({"element_size_mm": -1.0}, "positive"),
        ({"element_size_mm": float("nan")}, "positive"),
        ({"element_size_mm": 13.0}, "too large for a body that is 50 mm"),
        ({"nodes": 0}, "positive"),
        ({"nodes": 100}, "too coarse"),
    ],
)
def test_refuses_invalid_requests(breast, request_, message):
    with pytest.raises(InputError, match=message):
        build_hierarchy(breast, **request_)


def test_refuses_volume_of_air():
    with pytest.raises(InputError, match="no tissue"):
        build_hierarchy(Volume(np.zeros((9, 9, 9), np.uint8), (2, 2, 2)), nodes=2000)


def test_refuses_body_of_one_voxel():
    labels = np.zeros((9, 9, 9), np.uint8)
    labels[4, 4, 4] = 1
    with pytest.raises(InputError, match="too thin"):
        build_hierarchy(Volume(labels, (2, 2, 2)), nodes=2000)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 2.5), (2.5, 1.0, 1.0), (1.0, 2.5, 1.0)])
def test_outline_is_a_distance_in_mm_for_any_voxels(spacing):
    """Across flat faces of a box the field grows by about 1 mm per mm, and is 0 on the face.

    The blur has the same width, in mm, along every axis. Between the two samples next to a face the
    slope is 1.11 along the longest step (a kernel of 0.9 steps has 0.443 in its middle, and
    0.9449 probit(0.5 + 0.443 / 2) = 0.555), and 1.04 along shorter ones, whose own width is
    less than that of the longest, which the distance is based on.
    """
    n = np.rint(np.array([40.0, 30.0, 20.0]) / spacing).astype(int)
    labels = Volume(np.ones(tuple(n[::-1]), np.uint8), spacing, (0.0, 0.0, 0.0))
    outline = outline_of(labels, 1.0)
    assert outline.step_mm == spacing
    middle = 0.5 * (outline.lower_mm + outline.upper_mm)
    for axis in range(3):
        inwards, outwards = middle.copy(), middle.copy()
        inwards[axis] = outline.upper_mm[axis] - 0.5 * spacing[axis]
        outwards[axis] = outline.upper_mm[axis] + 0.5 * spacing[axis]
        inner, outer = (distance_at(outline.field, outline.frame, *p) for p in (inwards, outwards))
        assert (outer - inner) / spacing[axis] == pytest.approx(1.08, abs=0.05)
        assert outer + inner == pytest.approx(0, abs=0.05)
