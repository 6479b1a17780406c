"""The fixed plate of thesis section 4.5.4, which holds what already touches it along x."""

from functools import cache

import numpy as np
import pytest
from pydantic import ValidationError

from palpate.storage.json_digests import to_plain
from palpate.testing.plugin_claims import small_breast
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem, frame_of
from palpate.workers.mechanics.fem.discretisation import Model, prepare
from palpate.workers.mechanics.fem.equilibrium_sensitivity import reactions, tangents
from palpate.workers.organs.breast.breast_effects import BREAST_MODEL
from palpate.workers.organs.breast.breast_keys import LoadSpec, ModelSpec
from palpate.workers.organs.breast.breast_problem import TOUCHING_MM, extent_of, problem_of

BENT = small_breast()
E_STEP_MPA = 1e-5


@cache
def model() -> Model:
    return prepare(build_hierarchy(BENT, nodes=900))


def touching() -> np.ndarray:
    height = model().finest.nodes[:, 1]
    return np.asarray(height <= height.min() + TOUCHING_MM)


def problem(*, holds: bool, **constants: float) -> Problem:
    load = LoadSpec(force_n=20.0, fixed_plate_holds_x=holds)
    values = BREAST_MODEL.complete(constants)
    frame = frame_of(model().finest.nodes)
    return problem_of(ModelSpec(skin="none"), load, values, extent_of(BENT), frame=frame)


def solved(of: Problem, start: Equilibrium | None = None) -> Equilibrium:
    found = equilibrium(model(), of, start)
    assert found.solution.outcome.converged, found.solution.outcome.reason
    return found


@cache
def pressed(*, holds: bool) -> Equilibrium:
    return solved(problem(holds=holds))


def test_a_leaning_breast_slides_along_x_unless_the_plate_holds_it() -> None:
    free, held = (pressed(holds=holds).solution.displacement_mm for holds in (False, True))
    assert 1 < touching().sum() < 40
    assert np.abs(free[touching(), 0]).mean() > 0.5
    assert not held[touching(), 0].any()


def test_held_nodes_carry_no_force_along_x_together() -> None:
    """Nothing else holds the body along x: the plates have no friction."""
    force = reactions(pressed(holds=True))[touching(), 0]
    assert np.abs(force).max() > 1e-3
    assert abs(force.sum()) < 1e-3 * np.abs(force).sum()


def test_apart_from_its_slide_the_body_is_deformed_almost_alike() -> None:
    free, held = (pressed(holds=holds).solution.displacement_mm for holds in (False, True))
    shift = held - free
    shift -= shift.mean(axis=0)
    assert np.linalg.norm(shift, axis=1).mean() < 0.02 * np.linalg.norm(free, axis=1).max()


def test_tangent_of_a_held_body_equals_the_difference_of_solutions() -> None:
    at = BREAST_MODEL.complete()["E_fat"]
    ahead, behind = (problem(holds=True, E_fat=at + way * E_STEP_MPA) for way in (1, -1))
    here = pressed(holds=True)
    (slope,) = tangents(here, [Change(ahead, behind, 2 * E_STEP_MPA)], 1e-7)
    there = [solved(p, here).solution.displacement_mm for p in (ahead, behind)]
    expected = (there[0] - there[1]) / (2 * E_STEP_MPA)
    assert np.abs(slope - expected).max() < 0.01 * np.abs(expected).max()


def test_without_the_key_nothing_is_held_and_old_studies_keep_their_digest() -> None:
    assert problem(holds=False).holds == ()
    assert [hold.axes for hold in problem(holds=True).holds] == [(True, False, False)]
    assert "fixed_plate_holds_x" not in to_plain(LoadSpec(force_n=20.0).model_dump())


@pytest.mark.parametrize(
    ("other", "named"), [({"moving": "both"}, "moving: both"), ({"oblique_deg": 45}, "oblique_deg")]
)
def test_a_plate_that_moves_or_is_oblique_holds_nothing(
    other: dict[str, object], named: str
) -> None:
    with pytest.raises(ValidationError, match=named):
        LoadSpec.model_validate({"force_n": 20, "fixed_plate_holds_x": True, **other})
