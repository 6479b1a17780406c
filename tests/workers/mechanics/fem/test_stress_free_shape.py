"""Stress-free shape of a body imaged under gravity."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem import body_equilibrium
from palpate.workers.mechanics.fem.body_equilibrium import equilibrium, solve, stress_free
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Constants, Problem
from palpate.workers.mechanics.fem.discretisation import Model, reshaped
from palpate.workers.mechanics.fem.equilibrium_sensitivity import tangents
from palpate.workers.mechanics.fem.loads_and_regions import NoPlates, Wall
from tests.workers.mechanics.fem.solids import body, box

CLAMPED = Wall(held=(True, True, True))
G = (0.3, -0.9, 0.3)
SOFT = Problem({Tissue.FAT: Constants(0.004, 0.49)}, NoPlates(), wall=CLAMPED, tolerance_mm=1e-4)


@pytest.fixture(scope="module")
def at_rest() -> Model:
    return body([(2, 2, 2), (4, 4, 4)], box(40.0, 40.0, 40.0), jitter=0.1)


@pytest.fixture(scope="module")
def imaged(at_rest) -> Model:
    """Return the body as imaged under gravity: every level in its own equilibrium."""
    hanging = equilibrium(at_rest, replace(SOFT, gravity_g=G, tolerance_mm=1e-5))
    assert np.abs(hanging.solution.displacement_mm).max() > 3.0
    return reshaped(at_rest, [state.x for state in hanging.states])


def test_without_gravity_the_body_returns_to_its_original_shape(at_rest, imaged):
    nearly_none = (0.0, 0.0, 1e-6)
    solution = solve(imaged, replace(SOFT, imaged_gravity_g=G, gravity_g=nearly_none))
    assert solution.outcome.converged, solution.outcome.reason
    found = imaged.finest.nodes + solution.displacement_mm
    np.testing.assert_allclose(found, at_rest.finest.nodes, atol=2e-3)
    assert solution.outcome.energy_mj < 1e-9


def test_unloaded_body_does_not_move(at_rest):
    """The out-of-balance force is rounding from the start."""
    solution = solve(at_rest, SOFT)
    assert solution.outcome.converged, solution.outcome.reason
    assert np.abs(solution.displacement_mm).max() < 1e-9


def test_under_the_same_gravity_nothing_moves(imaged):
    solution = solve(imaged, replace(SOFT, gravity_g=G, imaged_gravity_g=G))
    assert solution.outcome.converged, solution.outcome.reason
    assert np.abs(solution.displacement_mm).max() < 4 * SOFT.tolerance_mm
    assert solution.outcome.energy_mj > 0.01


def test_reversed_gravity_is_relative_to_the_image(at_rest, imaged):
    """Prone to supine equals loading the stress-free body from the start."""
    back = tuple(-g for g in G)
    direct = solve(at_rest, replace(SOFT, gravity_g=back)).displacement_mm
    solution = solve(imaged, replace(SOFT, gravity_g=back, imaged_gravity_g=G))
    expected = at_rest.finest.nodes + direct - imaged.finest.nodes
    np.testing.assert_allclose(solution.displacement_mm, expected, atol=2e-3)


def test_tangent_includes_the_change_of_the_stress_free_shape(imaged):
    """The derivative with respect to ln E of a body imaged and pressed under its weight
    agrees with differences of full solutions. With the shape held it would be off by a half."""
    turned = tuple(-g for g in G)

    def problem(log_change: float) -> Problem:
        fat = {Tissue.FAT: Constants(0.004 * np.exp(log_change), 0.49)}
        return replace(SOFT, constants=fat, gravity_g=turned, imaged_gravity_g=G, tolerance_mm=1e-5)

    def displacement(log_change: float) -> np.ndarray:
        return solve(imaged, problem(log_change)).displacement_mm

    h = 1e-3
    expected = (displacement(h) - displacement(-h)) / (2 * h)
    at = equilibrium(imaged, problem(0.0))
    (found,) = tangents(at, [Change(problem(h), problem(-h), 2 * h)])
    assert np.abs(found - expected).max() < 0.01 * np.abs(expected).max()


def test_shape_is_computed_once_for_all_loads(imaged, monkeypatch):
    """It does not depend on the loads, but on constants and weight."""
    found = []
    search = body_equilibrium._found_shape
    monkeypatch.setattr(
        body_equilibrium, "_found_shape", lambda *given: found.append(1) or search(*given)
    )
    hung = replace(SOFT, imaged_gravity_g=(0.01, 0.0, 0.0))
    first = stress_free(imaged, hung)
    assert stress_free(imaged, replace(hung, gravity_g=G, wall=Wall())) is first
    assert len(found) == 1
    stiffer = {Tissue.FAT: Constants(0.005, 0.49)}
    assert stress_free(imaged, replace(hung, constants=stiffer)) is not first
    assert stress_free(imaged, replace(hung, imaged_gravity_g=(0.02, 0.0, 0.0))) is not first
    assert len(found) == 3


def test_body_too_soft_for_its_weight_fails_with_a_reason(at_rest):
    jelly = {Tissue.FAT: Constants(2e-5, 0.49)}
    problem = replace(SOFT, constants=jelly, imaged_gravity_g=(0.0, -1.0, 0.0))
    outcome = solve(at_rest, problem).outcome
    assert not outcome.converged
    assert "No stress-free shape was found" in outcome.reason
