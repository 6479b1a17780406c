"""Deviations in the hard world: size, frequency and effect."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.blind.breast_scene import NU
from palpate.workers.blind.case_body import Segmenter, body_of, points_on, segmented
from palpate.workers.blind.case_deviations import Deviations, World, reshaped
from palpate.workers.blind.random_case import KINDS, draw
from palpate.workers.comparison.observation.interface_residual import GLANDULAR, signed_distance

HARD = [draw(seed, "control", world=World.hard) for seed in range(200)]


def test_plain_world_has_no_deviations():
    truth = draw(5, "tilt")
    assert truth.deviations == Deviations()
    assert (truth.scene.nu, truth.scene.wall_spring_factor) == (NU, 1.0)
    assert truth.scene.fibres is None


@pytest.mark.parametrize("kind", KINDS)
def test_body_causes_and_loads_are_the_same_in_both_worlds(kind):
    plain, hard = draw(5, kind), draw(5, kind, world=World.hard)
    assert replace(hard, deviations=plain.deviations) == plain
    assert hard.deviations != plain.deviations


def test_deviations_have_the_documented_sizes():
    off = [truth.deviations for truth in HARD]
    assert len({one.nu for one in off}) > 50
    assert all(0.488 <= one.nu <= 0.492 for one in off)
    assert all(0.97 <= one.wall_spring_factor <= 1.03 for one in off)
    assert all(0.5 <= one.noise_factor <= 2.0 for one in off)
    misstated = np.log([one.noise_factor for one in off])
    assert abs(misstated.mean()) < 0.1
    poses = np.array([pose for one in off for pose in one.poses])
    assert poses.shape == (800, 6)
    assert poses.std(axis=0) == pytest.approx(np.full(6, 0.3), rel=0.12)
    shapes = [one.shape for one in off if one.shape is not None]
    assert len(shapes) == len(set(shapes)) == 200
    assert all(0.05 <= one.amplitude <= 0.12 for one in shapes)
    tilts = np.array([one.fibre_tilt_deg for one in off])
    assert tilts.std() == pytest.approx(0.3, rel=0.15)


def test_bodies_of_any_shape_fill_the_same_box_without_folds():
    """The map preserves orientation everywhere, so no point passes another."""
    inside = np.random.default_rng(3).uniform(-1, 1, (4000, 3)) * [1.0, 1.0, 0.5] + [0, 0, 0.5]
    for truth in HARD[:30]:
        body = truth.anatomy
        points = inside * body.half_mm * [1, 1, 2] + [body.centre_mm[0], 0, 0]
        shape = truth.deviations.shape
        # Differences along the axes of all points at once, because the points define the box.
        moved = np.array([shape.moved(points + h) - shape.moved(points) for h in 1e-4 * np.eye(3)])
        assert np.linalg.det(moved.transpose(1, 2, 0) / 1e-4).min() > 0.3
        there = shape.moved(points)
        assert there.max(axis=0) == pytest.approx(points.max(axis=0))
        assert there[:, :2].min(axis=0) == pytest.approx(points[:, :2].min(axis=0))
        wall = points * [1, 1, 0]
        assert not shape.moved(np.vstack([points, wall]))[len(points) :, 2].any()
        assert np.abs(there - points).max() > 2.0


def test_labels_of_a_reshaped_body_match_its_mesh():
    truth = HARD[0]
    body = body_of(truth.anatomy, 800, 1.2)
    other = reshaped(body, truth.deviations.shape)
    corners = other.mesh.nodes[other.mesh.cells[:, :4]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert volumes.min() > 0
    assert len(other.mesh.wall) == len(body.mesh.wall)
    voxel = 1.2**3
    drawn = other.labels.values != Tissue.AIR
    assert drawn.sum() * voxel == pytest.approx(volumes.sum(), rel=5e-3)
    points = points_on(body.mesh, body.labels, 400, 1)
    gland = points.points[points.interface == 1]
    moved = truth.deviations.shape.moved(np.vstack([gland, body.mesh.nodes]))[: len(gland)]
    away, _ = signed_distance(other.labels, GLANDULAR.inside).at(moved)
    assert np.median(np.abs(away)) < 0.5


def test_pose_is_a_rigid_motion():
    off = replace(Deviations(), poses=((0.3, -0.2, 0.1, 0.4, -0.3, 0.5),))
    places = np.random.default_rng(2).uniform(-60, 60, (50, 3))
    shown = off.posed(0, places)
    apart = [np.linalg.norm(p[:, None] - p, axis=2) for p in (places, shown)]
    assert apart[0] == pytest.approx(apart[1], abs=1e-9)
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    # To first order a rotation is the cross product with its vector.
    turn = np.radians([0.4, -0.3, 0.5])
    expected = np.cross(turn, places - middle) + np.array([0.3, -0.2, 0.1])
    assert shown - places == pytest.approx(expected, abs=0.005)
    assert Deviations().posed(0, places) is places


def test_fibres_are_tilted_with_and_without_a_fibre_cause():
    points = np.random.default_rng(3).uniform(-30, 30, (20, 3)) + np.array([0.0, 0.0, 30.0])
    off = replace(Deviations(), fibre_tilt_deg=(3.0, 0.0))
    straight = replace(HARD[0], deviations=off).scene.fibres(points)
    assert straight == pytest.approx(
        np.tile([0, -np.sin(np.radians(3)), np.cos(np.radians(3))], (20, 1))
    )
    turned = draw(5, "fibres")
    both = replace(turned, deviations=off).scene.fibres(points)
    angle = np.degrees(np.arccos((both * turned.scene.fibres(points)).sum(axis=1)))
    assert angle.max() == pytest.approx(3.0, abs=0.2)
    assert np.linalg.norm(both, axis=1) == pytest.approx(1.0)


def block():
    values = np.zeros((80, 60, 60), np.uint8)
    values[:, 10:50, 10:50] = Tissue.FAT
    values[10:70, 20:40, 20:40] = Tissue.GLANDULAR
    return Volume(values, (0.8, 0.8, 0.8), (0.0, 0.0, 0.0))


def test_noise_increases_towards_the_wall():
    sd = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        drawn = segmented(block(), Segmenter(0.4, ln_at_wall=1.0), rng).values != 0
        reach = 0.8 * drawn[:, :30, 30].sum(axis=1)
        sd.append([reach[:25].std(), reach[-25:].std()])
    wall, nipple = np.sqrt((np.array(sd) ** 2).mean(axis=0))
    assert 1.3 < wall / nipple < 4.0


def test_hard_world_scans_miss_and_add_pieces_of_gland():
    true = block().values == Tissue.GLANDULAR
    plain = segmented(block(), Segmenter(0.05), np.random.default_rng(7)).values == 2
    off = segmented(block(), Segmenter(0.05, pieces=1), np.random.default_rng(7)).values == 2
    missed, added = (true & plain & ~off).sum(), (~true & ~plain & off).sum()
    ball = 4 / 3 * np.pi * np.array([3.0, 5.0]) ** 3 / 0.8**3
    assert 0.2 * ball[0] < missed <= 1.2 * ball[1]
    assert 0.2 * ball[0] < added <= 1.2 * ball[1]
