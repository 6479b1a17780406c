"""Effects of the bench and their actions on problems and observations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.mechanics.effects.effect import one_sided
from palpate.workers.mechanics.effects.loading_effects import GRAM, LOAD_SCALE
from palpate.workers.mechanics.effects.observation_effects import FRAME_TURN, MARKER_STANDOFF
from palpate.workers.mechanics.effects.support_effects import CLAMP_COMPLIANCE
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Frame, Problem
from palpate.workers.mechanics.fem.loads_and_regions import (
    Box,
    DeadForce,
    DisplacementField,
    Hold,
    NoPlates,
    Wall,
)
from palpate.workers.mechanics.model_parameters import MM_PER_KPA
from palpate.workers.organs.specimen.load_cells import LoadCell
from palpate.workers.organs.specimen.specimen_effects import specimen_effects

FRAME = Frame((5.0, 5.0, 20.0), (5.0, 5.0, 20.0))
TIP = Box((0, 0, 40), (10, 10, 40))
PROBLEM = Problem(
    {Tissue.FAT: Constants(0.1)},
    NoPlates(),
    wall=Wall((True, True, True)),
    forces=(DeadForce((0.0, -0.5, 0.1), TIP),),
    holds=(Hold(TIP, (0.0, -2.0, 0.0)),),
)
EFFECTS = specimen_effects(
    (0.0, -1.0, 0.0),
    (5.0, 5.0, 0.0),
    TIP,
    weightless=True,
    markers=True,
    clamped=True,
    known_nu=True,
    moved=True,
    cells=(LoadCell(TIP, 1, 2.0), LoadCell(TIP, 2, 4.0)),
    most_n=1.5,
)
BY_NAME = {e.name: e for e in EFFECTS}
every = pytest.mark.parametrize("e", EFFECTS, ids=lambda e: e.name)


@every
def test_parameters_are_consistent(e):
    assert e.summary.endswith(".")
    assert all(e.references)
    for parameter, sd, step in zip(e.parameters, e.prior_sd, e.steps, strict=True):
        assert parameter.lower <= parameter.neutral <= parameter.upper
        assert 0 < step < sd <= 2 * (parameter.upper - parameter.lower)
        if one_sided(parameter):
            with pytest.raises(InputError, match="at least"):
                parameter.check(parameter.neutral - step)


@every
def test_only_plausible_values_change_the_problem(e):
    assert e.apply(PROBLEM, e.neutral, FRAME) is PROBLEM
    assert e.acts_on(PROBLEM, FRAME)
    if e.observation is None:
        assert e.apply(PROBLEM, e.plausible, FRAME) != PROBLEM


def test_names_are_unique():
    names = [name for e in EFFECTS for name in e.names]
    assert len(set(names)) == len(names)


def test_catalogue_omits_effects_that_cannot_act():
    few = specimen_effects(
        (0, -1, 0), (0, 0, 0), None, weightless=False, markers=False, clamped=False, known_nu=True
    )
    left_out = set(BY_NAME) - {e.name for e in few}
    assert left_out == {
        "self_weight",
        "load_scale",
        "added_mass",
        "clamp_compliance",
        "marker_standoff",
        "grip_slip",
        "load_cell_offset",
    }


def test_self_weight_acts_down_with_a_known_size():
    weight = BY_NAME["self_weight"]
    assert weight.apply(PROBLEM, {"self_weight": 0.5}, FRAME).gravity_g == (0.0, -0.5, 0.0)
    assert weight.if_present == ((1.0, 0.02),)


def test_added_mass_is_a_force_of_its_weight():
    values = {"added_mass": GRAM.to_inside(10.0)}
    hung = BY_NAME["added_mass"].apply(PROBLEM, values, FRAME).forces
    assert hung[0] is PROBLEM.forces[0]
    assert hung[1].force_n == pytest.approx((0, -0.0980665, 0))


def test_load_scale_changes_forces_but_not_gravity():
    scaled = LOAD_SCALE.apply(PROBLEM, {"ln_load": np.log(2)}, FRAME)
    assert scaled.forces[0].force_n == pytest.approx((0, -1.0, 0.2))
    assert scaled.gravity_g == PROBLEM.gravity_g


def test_clamp_is_compliant_along_its_normal_only():
    values = {"clamp_compliance": MM_PER_KPA.to_inside(0.02)}
    wall = CLAMP_COMPLIANCE.apply(PROBLEM, values, FRAME).wall
    assert wall.held == (True, True, False)
    assert wall.spring_mpa_per_mm == pytest.approx((0, 0, 0.05))


def test_slip_shortens_all_prescribed_displacements():
    field = DisplacementField(((0, 0, 40), (10, 10, 40)), ((0.0, -2.0, 0.0), (0.0, -4.0, 0.0)))
    two = replace(PROBLEM, holds=(*PROBLEM.holds, Hold(TIP, field)))
    stated, measured = BY_NAME["grip_slip"].apply(two, {"grip_slip": 0.25}, FRAME).holds
    assert stated.displacement_mm == (0.0, -1.5, 0.0)
    assert measured.displacement_mm.displacement_mm == ((0.0, -1.5, 0.0), (0.0, -3.0, 0.0))
    with pytest.raises(InputError, match="below 1"):
        BY_NAME["grip_slip"].apply(two, {"grip_slip": 1.0}, FRAME)


def test_offset_changes_the_readings_of_its_own_cell():
    offset = BY_NAME["load_cell_offset"]
    points, normals = np.zeros((5, 3)), np.tile([0.0, 0.0, 1.0], (5, 1))
    values = {"cell_offset_1": 0.1, "cell_offset_2": -0.2}
    found = offset.shift(points, normals, np.ones(5), values, FRAME)
    assert found == pytest.approx([0, 0, 0, 0.2, -0.8])
    assert offset.prior_sd == pytest.approx((0.15, 0.15))


def test_base_motion_is_a_rigid_motion():
    """Small rotations about the clamp, compared with scipy's rotations."""
    rng = np.random.default_rng(0)
    points, normals = rng.uniform(0, 40, (6, 3)), np.tile(np.eye(3), (2, 1))
    shift, turn = np.array([0.1, -0.2, 0.3]), np.array([0.02, 0.01, -0.03])
    base = BY_NAME["base_motion"]
    values = dict(zip(base.names, [*shift, *turn], strict=True))
    found = base.shift(points, normals, np.ones(6), values, FRAME)
    centre = np.array([5.0, 5.0, 0.0])
    moved = Rotation.from_rotvec(turn, degrees=True).apply(points - centre) + centre + shift
    np.testing.assert_allclose(found, ((moved - points) * normals).sum(axis=1), atol=2e-5)


def test_frame_turn_rotates_displacements():
    rng = np.random.default_rng(1)
    moves, normals = rng.uniform(-10, 10, (3, 3)), np.eye(3)
    turn = np.array([0.03, -0.02, 0.01])
    assert FRAME_TURN.sees == "moves"
    values = dict(zip(FRAME_TURN.names, turn, strict=True))
    found = FRAME_TURN.shift(moves, normals, np.ones(3), values, FRAME)
    turned = Rotation.from_rotvec(turn, degrees=True).apply(moves)
    np.testing.assert_allclose(found, ((turned - moves) * normals).sum(axis=1), atol=1e-5)


def test_marker_standoff_moves_with_the_rotation_of_the_surface():
    """An arm of 6 mm along y rotated by 30 degrees about x: exact, not linearised."""
    R = Rotation.from_euler("x", 30, degrees=True).as_matrix()
    arm = np.tile(R @ [0, 1, 0] - [0, 1, 0], (3, 1))
    assert MARKER_STANDOFF.sees == "arms"
    found = MARKER_STANDOFF.shift(arm, np.eye(3), np.ones(3), {"marker_standoff": 6.0}, FRAME)
    np.testing.assert_allclose(found, [0, 6 * (np.sqrt(0.75) - 1), 3.0], atol=1e-12)
