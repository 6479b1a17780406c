"""The generator follows the nominal physics that the diagnosis assumes."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.blind.breast_scene import NU, WALL_SPRING_KPA_PER_MM, Scene
from palpate.workers.blind.case_body import GLANDULAR, body_of, points_on
from palpate.workers.blind.random_case import draw
from palpate.workers.blind.scene_solution import IN_AXES, plate_starts, plates_of, solve_scene
from palpate.workers.blind.solver.plate_equilibrium import topology_of
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.mechanics.effects.local_stiffness_effects import STIFFNESS_GRADIENT
from palpate.workers.mechanics.effects.material_effects import FIBRE_ROTATION
from palpate.workers.mechanics.effects.plate_effects import PLATE_TILT
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem, frame_of
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.mechanics.fem.loads_and_regions import Device, ForceControl, Wall
from palpate.workers.mechanics.fem.plate_contact import plate_contact
from palpate.workers.mechanics.fem.plate_surface import ContactNodes, Gap, plate_surfaces


@pytest.fixture(scope="module")
def truth():
    return draw(1, "control")


@pytest.fixture(scope="module")
def body(truth):
    return body_of(truth.anatomy, 1000)


def service_problem(truth, load, frame):
    k = truth.constants
    tissue = {
        Tissue.FAT: Constants(k.E_fat_kpa / 1e3, NU, k.eta_kpa / 1e3),
        Tissue.GLANDULAR: Constants(k.E_gl_kpa / 1e3, NU, k.eta_kpa / 1e3),
    }
    spring = WALL_SPRING_KPA_PER_MM / 1e3
    axis = tuple(float(x) for x in IN_AXES[load.axis][2])
    device = Device(axis, frame.centre_mm)
    plates = ForceControl(load.force_n, *plate_starts(truth.anatomy, load.axis), device)
    wall = Wall((False, False, True), (spring, spring, 0.0))
    return Problem(tissue, plates, isochoric_fibre=True, wall=wall)


@pytest.mark.parametrize("number", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_control_moves_like_the_nominal_model_of_the_diagnosis(truth, body, number):
    load = truth.loads[number]
    ours = solve_scene(truth.scene, topology_of(body.mesh), body.labels, [load])[0]
    hierarchy = build_hierarchy(body.labels, nodes=5000)
    model = prepare(hierarchy)
    problem = service_problem(truth, load, frame_of(model.finest.nodes))
    theirs = solve(model, problem)
    assert theirs.displacement_mm is not None
    points = points_on(body.mesh, body.labels, 400, 1)
    inner = points.interface == GLANDULAR
    at = interpolation_at_points(hierarchy.finest.mesh, points.points[inner])
    away = points.moved(ours.displacement_mm)[inner] - at @ theirs.displacement_mm
    moved = np.linalg.norm(at @ theirs.displacement_mm, axis=1).mean()
    assert moved > 2
    assert np.linalg.norm(away, axis=1).mean() < 0.03 * moved


@pytest.mark.parametrize("axis", ["y", "x"])
def test_tilt_has_the_sign_of_the_catalogue(truth, axis):
    scene = replace(truth.scene, tilt_deg=(3.0, -2.0))
    plate = plates_of(scene, axis)[1]
    direction = tuple(float(x) for x in IN_AXES[axis][2])
    device = Device(direction, truth.anatomy.centre_mm)
    load = ForceControl(1.0, *plate_starts(truth.anatomy, axis), device)
    problem = Problem({}, load)
    tilted = PLATE_TILT.apply(
        problem,
        {"tilt_depth": 3.0, "tilt_across": -2.0},
        frame_of(np.array([[0.0, 0, 0], [1, 1, 1]])),
    )
    upper = plate_surfaces(tilted.load.device, Gap(load.lower_mm, load.upper_mm))[1]
    points = np.random.default_rng(0).uniform(-40, 40, (50, 3))
    nodes = ContactNodes(np.arange(50, dtype=np.int32), np.ones(50))
    theirs = plate_contact(nodes, points, upper).gap
    s = (points - plate.pivot_mm) @ plate.frame[:2].T
    ours = plate.start_mm + s @ plate.slopes - points @ plate.frame[2]
    ours /= np.sqrt(1 + (plate.slopes**2).sum())
    assert np.corrcoef(ours, theirs)[0, 1] > 0.99999
    assert ours - ours.mean() == pytest.approx(theirs - theirs.mean(), abs=0.05)


def test_rotation_and_gradient_have_the_sign_of_the_catalogue(truth):
    body = truth.anatomy
    nodes = np.array(
        [np.subtract(body.centre_mm, body.half_mm), np.add(body.centre_mm, body.half_mm)]
    )
    frame = frame_of(nodes)
    points = np.random.default_rng(2).uniform(*nodes, (40, 3))
    bare = Problem({}, ForceControl(1.0, -1.0, 1.0))
    fibres = replace(draw(1, "fibres").causes[0], turn_deg=10.0, azimuth_deg=30.0, fan_deg=0.0)
    turns = np.array([10 * np.cos(np.pi / 6), 10 * np.sin(np.pi / 6)])
    theirs = FIBRE_ROTATION.apply(
        bare, dict(zip(FIBRE_ROTATION.names, turns.tolist(), strict=True)), frame
    ).fibres.directions(points)
    ours = fibres.apply_to(Scene(body, truth.constants)).fibres(points)
    assert np.abs((ours * theirs).sum(axis=1)).min() > np.cos(np.radians(0.3))
    gradient = draw(1, "gradient").causes[0]
    values = dict(
        zip(STIFFNESS_GRADIENT.names, (gradient.ln_x, gradient.ln_y, gradient.ln_z), strict=True)
    )
    line = STIFFNESS_GRADIENT.apply(bare, values, frame).variations[0].log_factor(points)
    curve = gradient.apply_to(Scene(body, truth.constants)).ln_stiffness[0](points)
    assert np.corrcoef(line, curve)[0, 1] > 0.9
    assert 0.5 < np.abs(curve).max() / np.abs(line).max() < 2
