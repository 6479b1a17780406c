"""What is off in the hard world: how much, how often, and that it does what it says."""

from dataclasses import replace

import numpy as np
import pytest

from storage.values import Tissue, Volume
from workers.blind.deviations import Deviations
from workers.blind.random_case import KINDS, draw
from workers.blind.scene import NU
from workers.blind.segmented_scan import Segmenter, segmented
from workers.blind.world import World

HARD = [draw(seed, "control", world=World.hard) for seed in range(200)]


def test_in_the_plain_world_nothing_is_off():
    truth = draw(5, "tilt")
    assert truth.deviations == Deviations()
    assert (truth.scene.nu, truth.scene.wall_spring_factor) == (NU, 1.0)
    assert truth.scene.fibres is None


@pytest.mark.parametrize("kind", KINDS)
def test_body_causes_and_loads_are_those_of_the_plain_world(kind):
    plain, hard = draw(5, kind), draw(5, kind, world=World.hard)
    assert replace(hard, deviations=plain.deviations) == plain
    assert hard.deviations != plain.deviations


def test_everything_is_a_little_off_by_what_is_said():
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
    tilts = np.array([one.fibre_tilt_deg for one in off])
    assert tilts.std() == pytest.approx(0.3, rel=0.15)


def test_a_pose_is_a_rigid_motion():
    off = replace(Deviations(), poses=((0.3, -0.2, 0.1, 0.4, -0.3, 0.5),))
    places = np.random.default_rng(2).uniform(-60, 60, (50, 3))
    shown = off.posed(0, places)
    apart = [np.linalg.norm(p[:, None] - p, axis=2) for p in (places, shown)]
    assert apart[0] == pytest.approx(apart[1], abs=1e-9)
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    # To first order a turn is the cross product with its vector.
    turn = np.radians([0.4, -0.3, 0.5])
    expected = np.cross(turn, places - middle) + np.array([0.3, -0.2, 0.1])
    assert shown - places == pytest.approx(expected, abs=0.005)
    assert Deviations().posed(0, places) is places


def test_fibres_are_tilted_with_and_without_a_cause_that_turns_them():
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


def test_noise_grows_towards_the_wall():
    sd = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        drawn = segmented(block(), Segmenter(0.4, ln_at_wall=1.0), rng).values != 0
        reach = 0.8 * drawn[:, :30, 30].sum(axis=1)
        sd.append([reach[:25].std(), reach[-25:].std()])
    wall, nipple = np.sqrt((np.array(sd) ** 2).mean(axis=0))
    assert 1.3 < wall / nipple < 4.0


def test_pieces_of_gland_are_missed_and_added():
    true = block().values == Tissue.GLANDULAR
    plain = segmented(block(), Segmenter(0.05), np.random.default_rng(7)).values == 2
    off = segmented(block(), Segmenter(0.05, pieces=1), np.random.default_rng(7)).values == 2
    missed, added = (true & plain & ~off).sum(), (~true & ~plain & off).sum()
    ball = 4 / 3 * np.pi * np.array([3.0, 5.0]) ** 3 / 0.8**3
    assert 0.2 * ball[0] < missed <= 1.2 * ball[1]
    assert 0.2 * ball[0] < added <= 1.2 * ball[1]
