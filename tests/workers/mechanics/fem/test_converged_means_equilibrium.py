"""Converged solutions are in equilibrium, whatever the constants and loads."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.level_equilibrium import LARGEST_UNBALANCED_SHARE
from palpate.workers.mechanics.fem.loads_and_regions import DistanceControl, ForceControl, Wall
from palpate.workers.mechanics.fem.mesh_level import Level
from tests.workers.mechanics.fem.solids import body, box

CLAMPED = Wall(held=(True, True, True))
MODEL = body([(2, 2, 2), (4, 4, 4)], box(30.0, 30.0, 30.0, origin=(-15.0, -15.0, 0.0)))


def pressed(young_kpa: float, force_n: float, fibre_kpa: float = 0.0) -> Equilibrium:
    """Return the equilibrium of a block between plates."""
    constants = {Tissue.FAT: Constants(young_kpa / 1e3, 0.49, fibre_mpa=fibre_kpa / 1e3)}
    load = ForceControl(force_n, -15.0, 15.0)
    return equilibrium(MODEL, Problem(constants, load, wall=CLAMPED))


def errors_n(found: Equilibrium) -> tuple[float, float]:
    """Return the out-of-balance force and the missing plate force, from a new level."""
    level = Level.build(MODEL.finest, found.problem)
    state = found.states[-1]
    at = level.energy(state, found.stage)
    left = level.force(state, at, found.stage) * level.free
    missing = at.contact.travel_force - (found.stage.force_n or 0.0)
    return float(np.linalg.norm(left)), abs(missing)


def test_ordinary_block_converges() -> None:
    found = pressed(10.0, 3.0, 20.0)
    assert found.solution.outcome.converged, found.solution.outcome.reason
    assert max(errors_n(found)) < LARGEST_UNBALANCED_SHARE * 3.0


@pytest.mark.parametrize("young_kpa", [1e9, 1e11])
def test_stiff_block_with_short_steps_is_solved_to_balance(young_kpa: float) -> None:
    found = pressed(young_kpa, 1.0)
    assert found.solution.outcome.converged, found.solution.outcome.reason
    assert max(errors_n(found)) < LARGEST_UNBALANCED_SHARE * 1.0


def test_start_from_a_stiff_block_is_solved_to_balance() -> None:
    near = pressed(1e9, 1.0)
    problem = replace(near.problem, load=ForceControl(1.2, -15.0, 15.0))
    found = equilibrium(MODEL, problem, near)
    assert found.solution.outcome.converged, found.solution.outcome.reason
    assert max(errors_n(found)) < LARGEST_UNBALANCED_SHARE * 1.2


def test_imbalance_due_to_rounding_is_not_converged() -> None:
    found = pressed(1e15, 1.0)
    outcome = found.solution.outcome
    assert max(errors_n(found)) > LARGEST_UNBALANCED_SHARE * 1.0
    assert not outcome.converged
    assert "of the load" in outcome.reason or "residual" in outcome.reason


@pytest.mark.parametrize("seed", range(4))
def test_every_converged_solution_is_in_equilibrium(seed: int) -> None:
    rng = np.random.default_rng(seed)
    done = 0
    for _ in range(12):
        young_kpa, force_n = 10 ** rng.uniform(-3, 9), 10 ** rng.uniform(-3, 4)
        fibre_kpa = float(rng.choice([0.0, 10 ** rng.uniform(-3, 9)]))
        found = pressed(young_kpa, force_n, fibre_kpa)
        outcome = found.solution.outcome
        assert outcome.converged == (not outcome.reason)
        if outcome.converged:
            done += 1
            assert max(errors_n(found)) <= LARGEST_UNBALANCED_SHARE * force_n, (young_kpa, force_n)
    assert done


def test_imbalance_at_a_given_plate_distance_is_small_relative_to_the_force() -> None:
    constants = {Tissue.FAT: Constants(0.01, 0.49)}
    problem = Problem(constants, DistanceControl(-13.0, 13.0), wall=CLAMPED)
    found = equilibrium(MODEL, problem)
    assert found.solution.outcome.converged
    assert errors_n(found)[0] < LARGEST_UNBALANCED_SHARE * found.solution.outcome.plate_force_n


def test_unloaded_body_converges() -> None:
    constants = {Tissue.FAT: Constants(0.01, 0.49)}
    found = equilibrium(MODEL, Problem(constants, DistanceControl(-20.0, 20.0), wall=CLAMPED))
    assert found.solution.outcome.converged
