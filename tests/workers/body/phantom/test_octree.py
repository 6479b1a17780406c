"""The octree equals the evaluation of every voxel with the Gaussian classifier."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import multivariate_normal

from palpate.workers.body.phantom.compartments import (
    FIRST_ID,
    LIGAMENT_ID,
    SKIN_ID,
    draw_compartments,
    fill_voxels,
    layer_frames,
)
from palpate.workers.body.phantom.octree import partition, shape_vector
from palpate.workers.body.phantom.phantom_settings import BreastPhantom

UNPACK = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])


def compartments_of(settings, seed=1):
    return draw_compartments(settings, np.random.default_rng(seed))


def evaluate_box(settings, compartments, box, ids):
    """Write the ids of the voxels in a box by evaluating each voxel with all compartments."""
    n = len(compartments.offset)
    fill_voxels(
        ids,
        np.array(box, np.int32),
        np.asarray(settings.origin_mm),
        float(settings.spacing_mm),
        shape_vector(settings),
        np.arange(n, dtype=np.int16),
        n,
        compartments.seeds_mm,
        compartments.precision,
        compartments.offset,
    )


def points_of(settings, zyx):
    return zyx[:, ::-1] * settings.spacing_mm + np.asarray(settings.origin_mm)


@pytest.fixture(scope="module")
def fine():
    """Return the default breast at 1 mm: settings, compartments, ids."""
    settings = BreastPhantom()
    compartments = compartments_of(settings)
    return settings, compartments, partition(settings, compartments)[0]


@pytest.mark.parametrize(
    ("preset", "changes", "seed"),
    [
        ("445ml", {}, 1),
        ("250ml", {}, 2),
        ("445ml", {"compartments": 800}, 3),
        ("445ml", {"compartments": 25, "ligament_mm": 3.0, "skin_mm": 4.0}, 4),
        ("250ml", {"ligament_mm": 0.0, "skin_mm": 0.0, "spacing_mm": 1.7}, 5),
    ],
)
def test_octree_equals_brute_force_on_the_whole_body(preset, changes, seed):
    settings = BreastPhantom.preset(preset, **{"spacing_mm": 2.0, **changes})
    compartments = compartments_of(settings, seed)
    ids, _ = partition(settings, compartments)
    nx, ny, nz = settings.shape_xyz
    expected = np.zeros_like(ids)
    evaluate_box(settings, compartments, [0, nx, 0, ny, 0, nz], expected)
    np.testing.assert_array_equal(ids, expected)


@pytest.mark.parametrize(
    "box",
    [
        [30, 70, 30, 70, 20, 50],  # around x = 0, with skin and air at the nipple
        [150, 170, 30, 70, 0, 20],  # upper end
        [0, 25, 0, 100, 0, 12],  # lower end
    ],
)
def test_octree_equals_brute_force_on_parts_at_1_mm(fine, box):
    settings, compartments, ids = fine
    expected = np.zeros_like(ids)
    evaluate_box(settings, compartments, box, expected)
    part = np.s_[box[4] : box[5], box[2] : box[3], box[0] : box[1]]
    np.testing.assert_array_equal(ids[part], expected[part])


def test_few_boxes_are_visited():
    settings = BreastPhantom()
    _, boxes = partition(settings, compartments_of(settings))
    assert boxes < 0.05 * np.prod(settings.shape_xyz)


def test_compartments_are_the_most_probable_gaussian_class(fine):
    settings, compartments, ids = fine
    zyx = np.argwhere(ids >= FIRST_ID)
    zyx = zyx[np.random.default_rng(0).choice(len(zyx), 3000, replace=False)]
    points = points_of(settings, zyx)
    log_probability = np.column_stack(
        [
            multivariate_normal(m, np.linalg.inv(s[UNPACK])).logpdf(points)
            for m, s in zip(compartments.seeds_mm, compartments.precision, strict=True)
        ]
    )
    np.testing.assert_array_equal(ids[tuple(zyx.T)] - FIRST_ID, log_probability.argmax(axis=1))


def test_ligament_is_within_half_its_thickness_of_a_wall(fine):
    """Walk from a voxel centre against the gradient of f_best - f_j in small steps."""
    settings, compartments, ids = fine
    zyx = np.argwhere(ids >= LIGAMENT_ID)
    zyx = zyx[np.random.default_rng(1).choice(len(zyx), 200, replace=False)]
    S, seeds = compartments.precision[:, UNPACK], compartments.seeds_mm

    def discriminants(points):
        d = points[..., None, :] - seeds
        return compartments.offset - 0.5 * np.einsum("...ni,nij,...nj->...n", d, S, d)

    steps = np.arange(0.0, settings.ligament_mm / 2 + 1e-9, 0.01)
    wrong = 0
    for point, here in zip(points_of(settings, zyx), ids[tuple(zyx.T)], strict=True):
        f = discriminants(point)
        i = int(f.argmax())
        gradient = -np.einsum("nij,nj->ni", S, point - seeds)
        slope = gradient[i] - gradient
        slope[i] = 1.0
        direction = slope / np.linalg.norm(slope, axis=1, keepdims=True)
        near = np.flatnonzero((f[i] - f < 2.0) & (np.arange(len(f)) != i))
        path = point - steps[:, None, None] * direction[near]
        along = discriminants(path)  # (steps, near, n)
        difference = along[..., i] - along[:, np.arange(len(near)), near]
        wrong += bool((difference <= 0).any()) != (here == LIGAMENT_ID)
    # Only walls that cross within a step of the end of the walk may differ.
    assert wrong <= 2
    share = np.mean(ids[tuple(zyx.T)] == LIGAMENT_ID)
    assert 0.05 < share < 0.25


def test_same_points_get_the_same_ids_at_another_spacing():
    """Centres of 1.5 mm voxels are the centres of every third 0.5 mm voxel."""
    coarse, fine = (
        BreastPhantom(
            spacing_mm=h, lower_mm=30, upper_mm=45, half_width_mm=30, depth_mm=30, compartments=80
        )
        for h in (1.5, 0.5)
    )
    compartments = compartments_of(fine)
    np.testing.assert_array_equal(compartments.seeds_mm, compartments_of(coarse).seeds_mm)
    a, b = partition(coarse, compartments)[0], partition(fine, compartments)[0]
    # Equal up to points that rounding of the coordinates moves across a border.
    assert np.count_nonzero(a != b[1::3, 1::3, 1::3]) <= 2


@pytest.mark.parametrize("skin", [1.5, 2.5])
def test_skin_has_the_requested_thickness(skin):
    """Distance to a dense sample of the outline, independent of the kernel's formula."""
    settings = BreastPhantom(
        lower_mm=30, upper_mm=60, half_width_mm=35, depth_mm=30, skin_mm=skin, compartments=50
    )
    ids, _ = partition(settings, compartments_of(settings))
    t = np.linspace(0, np.pi / 2, 350)
    p = np.linspace(0, 2 * np.pi, 1000)
    # Beyond the chest wall too: the skin is cut there, not closed.
    polar, around = (v.ravel() for v in np.meshgrid(np.append(t, t[1:40] + np.pi / 2), p))
    x = np.sin(polar) * np.cos(around)
    outline = np.column_stack(
        [
            x * np.where(x >= 0, settings.upper_mm, settings.lower_mm),
            settings.half_width_mm * np.sin(polar) * np.sin(around),
            settings.depth_mm * np.cos(polar),
        ]
    )
    zyx = np.argwhere(ids > 0)
    depth, _ = cKDTree(outline).query(points_of(settings, zyx), distance_upper_bound=skin + 0.2)
    is_skin = ids[tuple(zyx.T)] == SKIN_ID
    assert is_skin.sum() > 5000
    assert depth[is_skin].max() < skin + 0.05
    assert depth[~is_skin].min() > skin - 0.05


def test_layer_frames_are_orthogonal_and_radial():
    settings = BreastPhantom()
    points = np.array([[10.0, 20, 5], [-30, -10, 12], [0, 0, 25], [80, 0, 1], [0, -40, 10]])
    frames = layer_frames(settings, points)
    np.testing.assert_allclose(
        np.einsum("nai,nbi->nab", frames, frames), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12
    )
    assert np.all(np.einsum("ni,ni->n", frames[:, 0], points) > 0)  # outward
    np.testing.assert_allclose(frames[:, 1, 2], 0, atol=1e-15)  # circumferential


def test_seeds_are_inside_and_separated():
    settings = BreastPhantom()
    seeds = compartments_of(settings, 9).seeds_mm
    c = np.where(seeds[:, 0] >= 0, settings.upper_mm, settings.lower_mm)
    q = (seeds[:, 0] / c) ** 2 + (seeds[:, 1] / 50) ** 2 + (seeds[:, 2] / 50) ** 2
    assert len(seeds) == 333
    assert q.max() <= 1
    assert seeds[:, 2].min() >= 0
    distance, _ = cKDTree(seeds).query(seeds, k=2)
    assert distance[:, 1].min() >= 4.9
