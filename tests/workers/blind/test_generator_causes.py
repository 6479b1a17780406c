"""Effects of causes on a body, checked against laws that need no second solver."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.blind.breast_scene import Anatomy, Constants, Scene
from palpate.workers.blind.case_body import body_of
from palpate.workers.blind.random_case import draw
from palpate.workers.blind.scene_solution import solve_scene, tether_of
from palpate.workers.blind.setup_causes import ShortPlate, Tether, WallRise
from palpate.workers.blind.solver.plate_contact import EDGE_FADE_MM
from palpate.workers.blind.solver.plate_equilibrium import topology_of
from palpate.workers.blind.tissue_causes import FibreContrast, Swelling

SEED = 2


@pytest.fixture(scope="module")
def truth():
    return draw(SEED, "control", one_direction=True)


@pytest.fixture(scope="module")
def body(truth):
    return body_of(truth.anatomy, 600, 1.5)


@pytest.fixture(scope="module")
def pressed(truth, body):
    """Return a function that solves the smaller load, with or without a cause."""
    topology = topology_of(body.mesh)

    def solve(cause=None):
        scene = cause.apply_to(truth.scene) if cause else truth.scene
        return solve_scene(scene, topology, body.labels, truth.loads[:1])[0]

    return solve


@pytest.fixture(scope="module")
def control(pressed):
    return pressed()


def root_mean_square(vectors):
    return np.sqrt((vectors**2).sum(axis=1).mean())


def volume(mesh, displacement_mm):
    """Return the volume of the tetrahedra between the corners."""
    x = (mesh.nodes + displacement_mm)[mesh.cells[:, :4]]
    return np.linalg.det(x[:, 1:] - x[:, :1]).sum() / 6


@pytest.mark.parametrize(
    ("cause", "least_mm", "most_mm"),
    [
        pytest.param(ShortPlate(2.0), 0.1, 2.0, marks=pytest.mark.slow),
        (ShortPlate(8.0), 0.5, 6.0),
        (WallRise(5.0, -3.0, 25.0, 3.0), 0.3, 3.0),
        pytest.param(WallRise(5.0, -3.0, 25.0, -3.0), 0.3, 3.0, marks=pytest.mark.slow),
        (Tether(10.0, 60.0, 0.15), 0.1, 4.0),
        (FibreContrast(6.0, 0.0), 0.03, 1.0),
        pytest.param(FibreContrast(1 / 6.0, 0.0), 0.03, 1.0, marks=pytest.mark.slow),
        (Swelling(0.06, 0.1), 0.1, 2.0),
    ],
    ids=str,
)
def test_cause_moves_the_body_by_a_plausible_amount(pressed, control, cause, least_mm, most_mm):
    away = pressed(cause).displacement_mm - control.displacement_mm
    assert least_mm < root_mean_square(away) < most_mm


@pytest.mark.slow
def test_short_plates_press_only_in_front_of_their_edge(truth, body, pressed):
    edge = 10.0
    found = pressed(ShortPlate(edge))
    upper = truth.anatomy.half_width_mm - found.travel_mm
    x = (body.mesh.nodes + found.displacement_mm)[np.unique(body.mesh.skin)]
    in_front = x[:, 2] > edge + EDGE_FADE_MM
    # Nodes between the points at which plates press may protrude a little.
    assert x[in_front, 1].max() < upper + 0.3
    assert x[~in_front, 1].max() > upper + 1.0
    assert (x[in_front, 1] > upper - 0.3).any()


def test_rising_wall_moves_as_given_and_pushes_the_body(truth, body, pressed, control):
    """Tissue hardly loses volume, so the volume of the rise is pushed out in front."""
    cause = WallRise(5.0, -3.0, 20.0, 2.0)
    wall = np.unique(body.mesh.wall)
    found = pressed(cause)
    said = cause.apply_to(truth.scene).wall_rise_mm(body.mesh.nodes[wall])
    assert found.displacement_mm[wall, 2] == pytest.approx(said, abs=1e-12)
    assert np.abs(control.displacement_mm[wall, 2]).max() == 0
    taken = volume(body.mesh, found.displacement_mm) - volume(body.mesh, control.displacement_mm)
    assert abs(taken) < 0.1 * 2 * np.pi * 20.0**2 * 2.0


def test_tether_holds_its_patch_of_skin(truth, body, pressed, control):
    tether = Tether(10.0, 60.0, 2.0)
    nodes = np.unique(body.mesh.skin)
    held = nodes[tether.apply_to(truth.scene).skin_grip(body.mesh.nodes[nodes]) > 0]
    assert len(held) > 10
    with_it = np.linalg.norm(pressed(tether).displacement_mm[held], axis=1)
    without = np.linalg.norm(control.displacement_mm[held], axis=1)
    assert with_it.mean() < 0.4 * without.mean()


@pytest.mark.slow
def test_swollen_gland_enlarges_the_body_by_its_uptake(body, pressed, control):
    inside = body.labels.values[body.labels.values != Tissue.AIR]
    share = np.mean(inside == Tissue.GLANDULAR)
    found = volume(body.mesh, pressed(Swelling(0.1, 0.0)).displacement_mm)
    grown = found / volume(body.mesh, control.displacement_mm) - 1
    assert grown == pytest.approx(0.1 * share, rel=0.1)


def test_area_of_the_skin_matches_the_mesh_and_a_sphere(truth, body):
    points, areas = truth.anatomy.skin()
    assert truth.anatomy.depth_inside(points) == pytest.approx(0, abs=1e-9)
    x = body.mesh.nodes[body.mesh.skin[:, :3]]
    meshed = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum()
    # A voxel body has no corner at the chest wall, and flat faces are smaller than curved ones.
    assert areas.sum() == pytest.approx(meshed, rel=0.03)
    ball = Anatomy(0, 50.0, 50.0, 50.0, 50.0, 40, 0.2)
    points, areas = ball.skin()
    assert areas.sum() == pytest.approx(2 * np.pi * 50**2)
    assert areas[points[:, 0] > 25].sum() == pytest.approx(np.pi * 50 * 25, rel=0.01)


def test_tether_stiffness_is_preserved_on_the_mesh(truth, body):
    skin = topology_of(body.mesh).skin
    totals = []
    for seed in range(60):
        cause = Tether.draw(np.random.default_rng(seed), truth.anatomy)
        springs = tether_of(cause.apply_to(truth.scene), skin)
        totals.append(float((skin.areas * springs).sum()))
        assert 0.04 < np.mean(springs > 0) < 0.25
    assert 0.045 < min(totals) < 0.1
    assert 0.6 < max(totals) < 1.1
    assert tether_of(truth.scene, skin) is None


def test_scan_is_scaled_about_the_centre_of_the_body(truth):
    scene = replace(truth.scene, image_scale=(0.0, 0.02, 0.0))
    low = np.subtract(truth.anatomy.centre_mm, truth.anatomy.half_mm)
    high = np.add(truth.anatomy.centre_mm, truth.anatomy.half_mm)
    drawn = scene.drawn(np.array([low, high, truth.anatomy.centre_mm]))
    half = truth.anatomy.half_width_mm
    assert drawn[:, 1] == pytest.approx([-1.02 * half, 1.02 * half, 0.0])
    assert drawn[:, [0, 2]] == pytest.approx(
        np.array([low, high, truth.anatomy.centre_mm])[:, [0, 2]]
    )
    plain = Scene(truth.anatomy, Constants(10.0, 30.0, 80.0))
    assert np.array_equal(plain.drawn(drawn), drawn)
