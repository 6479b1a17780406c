"""Contract of every effect, independent of the solver."""

import math
import pickle
from copy import deepcopy
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.mechanics.effects.effect import Effect, one_sided, renamed
from palpate.workers.mechanics.effects.observation_effects import rigidly_moved
from palpate.workers.mechanics.effects.support_effects import CLAMP_COMPLIANCE, base_motion
from palpate.workers.mechanics.fem.boundary_value_problem import Frame
from palpate.workers.mechanics.fem.loads_and_regions import NoPlates, Wall
from palpate.workers.mechanics.model_parameters import (
    BREAST,
    KPA_PER_MM,
    MM,
    MM_PER_KPA,
    N_PER_M,
    Parameter,
)
from palpate.workers.organs.breast.breast_effects import BREAST_EFFECTS, CATALOGUE
from tests.workers.mechanics.effects.lopsided import HALF_MM, busy, plain, problem

effect = CATALOGUE.named
FRAME = Frame((1.0, -2.0, 20.0), tuple(HALF_MM))
PROBLEMS = (plain(), busy())
# Effects on the body and its load.
ON_PROBLEM = [e for e in BREAST_EFFECTS if e.observation is None]
ON_IMAGE = [e for e in BREAST_EFFECTS if e.observation is not None]
every = pytest.mark.parametrize("e", BREAST_EFFECTS, ids=lambda e: e.name)
on_problem = pytest.mark.parametrize("e", ON_PROBLEM, ids=lambda e: e.name)
on_image = pytest.mark.parametrize("e", ON_IMAGE, ids=lambda e: e.name)


def same(a, b):
    """Test whether problems are equal up to rounding, number by number."""
    if isinstance(a, float) or isinstance(b, float):
        return a == pytest.approx(b, rel=1e-13, abs=1e-15)
    if hasattr(a, "__dataclass_fields__"):
        return type(a) is type(b) and all(
            same(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__
        )
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(p, q) for p, q in zip(a, b, strict=True))
    return a == b


@every
@pytest.mark.parametrize("base", PROBLEMS, ids=["plain", "busy"])
def test_neutral_changes_nothing(e, base):
    assert e.apply(base, {}, FRAME) is base
    assert e.apply(base, e.neutral, FRAME) is base
    neutral = e.transform(base, e.neutral, FRAME)
    # A zero gradient, and fibres without stiffness along another axis, remain in the problem.
    bare = replace(neutral, variations=base.variations, fibres=base.fibres)
    assert same(bare, base)
    points = np.random.default_rng(0).uniform(-40, 40, (20, 3))
    for variation in neutral.variations:
        assert not variation.log_factor(points).any()
    np.testing.assert_array_equal(neutral.fibres.directions(points), base.fibres.directions(points))


@on_problem
@pytest.mark.parametrize("base", PROBLEMS, ids=["plain", "busy"])
def test_each_plausible_value_changes_something(e, base):
    if e.name == "skin_scaled" and base.membrane is None:
        assert not e.acts_on(base, FRAME)
        return
    assert e.acts_on(base, FRAME)
    for name, value in e.plausible.items():
        if name not in e.names[: e.size_count]:
            continue
        assert e.apply(base, {name: value}, FRAME) != base


@every
def test_parameters_are_complete(e):
    assert e.summary.endswith(".")
    assert e.references
    assert all(e.references)
    for parameter, sd, step in zip(e.parameters, e.prior_sd, e.steps, strict=True):
        assert parameter.neutral is not None
        assert parameter.lower <= parameter.neutral <= parameter.upper
        assert 0 < step < sd <= 2 * (parameter.upper - parameter.lower)
        assert parameter.description
        parameter.check(parameter.neutral)
        if one_sided(parameter):
            with pytest.raises(InputError, match="at least"):
                parameter.check(parameter.neutral - step)
        if parameter.unit.symbol:
            assert parameter.door_name != parameter.name


def test_names_are_one_vocabulary():
    vocabulary = BREAST.extended_by(CATALOGUE.parameters)
    assert len(set(vocabulary.door_names)) == len(vocabulary)
    assert len({e.name for e in BREAST_EFFECTS}) == len(BREAST_EFFECTS)
    stated = vocabulary.from_door(
        {"wall_compliance_mm_per_kpa": 0.1, "skin_added_n_per_m": 300.0, "tilt_depth_deg": 2.0}
    )
    assert stated == {"tilt_depth": 2.0, "wall_compliance": 100.0, "skin_added": 0.3}


@every
def test_arguments_are_not_mutated(e):
    for base in (plain(), busy()):
        before = deepcopy(base)
        e.apply(base, e.plausible, FRAME)
        assert base == before


@pytest.mark.parametrize("base", PROBLEMS, ids=["plain", "busy"])
@pytest.mark.parametrize(
    ("first", "second"),
    [pair for pair in combinations(BREAST_EFFECTS, 2) if pair[0].family != pair[1].family],
    ids=lambda e: e.name,
)
def test_families_commute(first, second, base):
    def after(problem, *effects):
        for e in effects:
            problem = e.apply(problem, e.plausible, FRAME)
        return problem

    assert same(after(base, first, second), after(base, second, first))


def test_catalogue_applies_the_named_effects():
    values = {"tilt_depth": 2.0, "creep": 0.2, "stiffening": 1.0}
    made = CATALOGUE.apply(plain(), values, FRAME)
    expected = effect("plate_tilt").apply(plain(), {"tilt_depth": 2.0}, FRAME)
    expected = effect("strain_stiffening").apply(expected, {"stiffening": 1.0}, FRAME)
    assert made == effect("creep").apply(expected, {"creep": 0.2}, FRAME)
    assert CATALOGUE.apply(plain(), {}, FRAME) == plain()
    with pytest.raises(InputError, match="did you mean 'tilt_depth'"):
        CATALOGUE.apply(plain(), {"tild_depth": 1.0}, FRAME)


def test_rejects_unknown_names_and_invalid_values():
    with pytest.raises(InputError, match="did you mean 'plate_friction'"):
        effect("plate_fricton")
    with pytest.raises(InputError, match="friction must be at least 0"):
        effect("plate_friction").apply(plain(), {"friction": -0.1}, FRAME)
    with pytest.raises(InputError, match="unknown parameter 'tilt'"):
        effect("plate_friction").apply(plain(), {"tilt": 0.1}, FRAME)
    assert not {name for name, _ in CATALOGUE.not_simulated} & {e.name for e in BREAST_EFFECTS}


def test_rejects_incomplete_effects():
    friction = effect("plate_friction")
    with pytest.raises(InputError, match="prior_sd > 0 for each of its 1"):
        replace(friction, prior_sd=())
    with pytest.raises(InputError, match="steps > 0"):
        replace(friction, steps=(0.0,))
    loose = Parameter("E_x", MM, 1.0, 2.0, None, "follows", follows="E_fat")
    with pytest.raises(InputError, match="a neutral value for E_x"):
        replace(friction, parameters=(loose,))


def test_rejects_inconsistent_fields():
    friction, creep = effect("plate_friction"), effect("creep")
    with pytest.raises(InputError, match="a place inside the body for a map"):
        replace(creep, is_mapped=True)
    with pytest.raises(InputError, match="a place inside the body for a map"):
        replace(effect("local_attachment"), is_mapped=True)
    assert friction.is_searched({"E_fat", "friction"})
    assert not friction.is_searched({"E_fat"})
    assert replace(friction, searched_as=("rubbing",)).is_searched({"rubbing"})


def test_effects_are_proportional_unless_local_or_one_sided():
    proportional = {e.name for e in BREAST_EFFECTS if e.is_proportional}
    assert {"plate_tilt", "gravity_change", "growth"} < proportional
    assert not proportional & {"plate_friction", "inclusion", "local_attachment", "plate_edge"}


@pytest.mark.parametrize("e", [e for e in ON_IMAGE if e.moves_scan], ids=lambda e: e.name)
def test_scan_motion_has_three_shifts_and_three_rotations(e):
    points, normals, tissues = interface()
    moved = rigidly_moved(points, np.array(e.prior_sd), FRAME.centre_mm) - points
    shift = e.shift(points, normals, tissues, e.plausible, FRAME)
    assert shift == pytest.approx((moved * normals).sum(axis=1))


def test_renamed_parameters_are_read_from_a_blind_case():
    truth = renamed(tilt_depth_deg="depth_deg")
    assert pickle.loads(pickle.dumps(truth))({"depth_deg": 2, "other": 1}) == {
        "tilt_depth_deg": 2.0
    }


@on_problem
def test_differences_are_central_or_one_sided(e: Effect):
    at = e.neutral
    for parameter, change in zip(e.parameters, e.changes(plain(), FRAME, at), strict=True):
        step = e.steps[e.parameters.index(parameter)]
        low = at[parameter.name] - step
        if one_sided(parameter) and low < 0:
            low = at[parameter.name]
        high = low + change.step
        assert change.step == pytest.approx(step if low == at[parameter.name] else 2 * step)
        assert change.minus == e.apply(plain(), {**at, parameter.name: low}, FRAME)
        assert same(change.plus, e.apply(plain(), {**at, parameter.name: high}, FRAME))


# Effects on the observation.


def interface():
    rng = np.random.default_rng(7)
    normals = rng.standard_normal((60, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = np.asarray(FRAME.centre_mm) + normals * HALF_MM
    tissues = rng.choice([Tissue.FAT, Tissue.GLANDULAR, Tissue.LIGAMENT], 60)
    return points, normals, tissues


@on_image
def test_observation_is_linear_and_leaves_the_body_alone(e):
    body = interface()
    assert e.apply(busy(), e.plausible, FRAME) == busy()
    assert not e.shift(*body, e.neutral, FRAME).any()
    columns = e.observation(*body, FRAME)
    assert columns.shape == (60, len(e.parameters))
    for k, name in enumerate(e.names):
        assert e.shift(*body, {name: 0.7}, FRAME) == pytest.approx(0.7 * columns[:, k])
    together = e.shift(*body, e.plausible, FRAME)
    assert together == pytest.approx(columns @ np.array(e.prior_sd))
    assert (e.changes(plain(), FRAME)[0].plus) == plain()


def test_segmentation_offset_moves_its_tissue_only():
    points, normals, tissues = interface()
    e = effect("segmentation_offset")
    shift = e.shift(points, normals, tissues, {"segmentation_glandular": 0.5}, FRAME)
    np.testing.assert_array_equal(shift, np.where(tissues == Tissue.GLANDULAR, 0.5, 0.0))
    assert not effect("creep").shift(points, normals, tissues, {"creep": 0.1}, FRAME).any()


@pytest.mark.parametrize(
    ("e", "centre_mm"),
    [(effect("rigid_motion"), FRAME.centre_mm), (base_motion((3.0, -5.0, 7.0)), (3.0, -5.0, 7.0))],
    ids=["body", "base"],
)
def test_rigid_motion_equals_a_rotation_matrix(e, centre_mm):
    """The error against the exact motion falls with the square of the angle."""
    from scipy.spatial.transform import Rotation

    points, normals, tissues = interface()
    errors = []
    for size in (1.0, 0.5):
        turn = size * np.array([1.5, -1.0, 2.0])
        move = size * np.array([0.3, 0.2, -0.4])
        arm = points - np.asarray(centre_mm)
        exact = Rotation.from_rotvec(turn, degrees=True).apply(arm) + move - arm
        values = dict(zip(e.names, [*move, *turn], strict=True))
        shift_mm = e.shift(points, normals, tissues, values, FRAME)
        errors.append(np.abs(shift_mm - (exact * normals).sum(axis=1)).max())
    assert errors[0] < 0.06
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_clamp_compliance_keeps_springs_along_x_and_y():
    sliding = replace(
        plain(), wall=Wall(held=(False, False, True), spring_mpa_per_mm=(0.1, 0.2, 0.0))
    )
    values = {"clamp_compliance": 4.0}
    wall = CLAMP_COMPLIANCE.apply(sliding, values, FRAME).wall
    assert wall.held == (False, False, False)
    assert wall.spring_mpa_per_mm == (0.1, 0.2, 0.25)
    loose = replace(sliding, wall=wall)
    assert CLAMP_COMPLIANCE.apply(loose, values, FRAME) == loose  # already compliant


def test_units_survive_a_round_trip():
    for unit, door in ((KPA_PER_MM, 0.3), (MM_PER_KPA, 0.3), (N_PER_M, 1234.5), (MM, 1.1)):
        assert unit.to_door(unit.to_inside(door)) == pytest.approx(door, rel=1e-15)
    assert problem(NoPlates()).constants[Tissue.FAT].young_mpa == 0.010
