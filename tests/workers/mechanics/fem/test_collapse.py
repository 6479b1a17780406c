"""Bodies whose elements collapse: stiff glands pressing on soft fat."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.common_keys import validated
from palpate.workers.mechanics.fem.body_equilibrium import (
    Equilibrium,
    equilibrium,
    solution_at_end,
    solve,
)
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.discretisation import History, Model, prepare
from palpate.workers.mechanics.fem.load_path import LoadStepping
from palpate.workers.mechanics.fem.loads_and_regions import ForceControl, Wall
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.organs.breast.breast_keys import BreastCase
from palpate.workers.organs.breast.breast_organ import ORGAN
from palpate.workers.organs.breast.breast_problem import extent_of
from tests.workers.mechanics.fem.solids import body, box

FORCE_N = 350.0


@pytest.fixture(scope="module")
def breast() -> tuple[Model, Problem]:
    """Return a breast with glands forty times as stiff as its fat."""
    case = validated(
        BreastCase,
        {
            "reference": {"phantom": {"spacing_mm": 2.0, "seed": 12}},
            "mesh": {"nodes": 900},
            "load": {"force_n": FORCE_N},
        },
    )
    labels = ORGAN.make_body(case.reference)
    model = prepare(ORGAN.make_mesh(labels, case))
    constants = case.complete({"E_fat": 0.005, "E_glandular": 0.2})
    return model, ORGAN.problem(model, case, constants, extent_of(labels))


@pytest.fixture(scope="module")
def found(breast: tuple[Model, Problem]) -> Equilibrium:
    return equilibrium(*breast)


def ordinary(model: Model, problem: Problem) -> LoadStepping:
    """Return the levels of a body without a barrier."""
    levels = tuple(Level.build(level, problem) for level in model)
    return LoadStepping(model, problem, levels)


def test_without_a_barrier_the_reason_names_the_collapsed_tissue(breast):
    model, problem = breast
    path = ordinary(model, problem).from_rest([History() for _ in model])
    assert path.collapsed
    outcome = solution_at_end(path.levels[-1], model.finest, path).outcome
    assert not outcome.converged
    assert not outcome.squeezed
    assert "elements, most of them fat, are squeezed to less than 0.3" in outcome.reason


def test_collapse_is_detected_before_the_iterations_run_out(breast):
    """No schedule with more stages is tried, and no further steps are taken."""
    path = ordinary(*breast).from_rest([History() for _ in breast[0]])
    assert path.stage.fraction == 1
    assert path.results[-1].iterations < 25
    assert "elements collapse" in path.reason


def test_rising_residuals_far_from_equilibrium_are_not_a_collapse():
    """A corner of the demo's bounds: the residual rises for seven iterations, then converges."""
    case = validated(
        BreastCase,
        {
            "reference": {"phantom": {"spacing_mm": 1.0, "glandular_fraction": 0.2, "seed": 1}},
            "mesh": {"nodes": 2000},
            "load": {"force_n": 100.0},
        },
    )
    labels = ORGAN.make_body(case.reference)
    model = prepare(ORGAN.make_mesh(labels, case))
    moduli = {"E_fat": 0.005, "eta_fat": 0.05, "E_glandular": 0.08, "eta_glandular": 0.05}
    problem = ORGAN.problem(model, case, case.complete(moduli), extent_of(labels))
    found = equilibrium(model, problem)
    assert found.solution.outcome.converged
    assert found.solution.outcome.min_j < 0.5
    assert found.levels[-1].barrier is None


def test_problem_without_restarts_uses_all_iterations(breast):
    model, problem = breast
    outcome = solve(model, replace(problem, restarts=False)).outcome
    assert "60 Newton iterations" in outcome.reason


def test_collapsing_body_is_solved_with_the_barrier(found):
    outcome = found.solution.outcome
    assert outcome.converged, outcome.reason
    assert all(level.barrier is not None for level in found.levels)
    assert outcome.min_j > 0.2
    assert outcome.plate_force_n == pytest.approx(FORCE_N, rel=1e-4)
    assert outcome.residual_n < 1e-3 * FORCE_N


def test_start_from_a_collapsing_body_keeps_the_barrier(breast, found):
    again = equilibrium(*breast, found)
    assert again.levels[-1].barrier is not None
    moved = again.solution.displacement_mm - found.solution.displacement_mm
    assert np.abs(moved).max() < 0.01


@pytest.mark.parametrize(("force_n", "squeezed"), [(100.0, False), (300.0, True)])
def test_flags_elements_below_three_tenths_of_their_volume(force_n, squeezed):
    model = body([(4, 4, 4), (8, 8, 8)], box(30, 30, 30, origin=(-15, -15, 0)), jitter=0.25)
    constants = {Tissue.FAT: Constants(0.005, 0.49, 0.02)}
    wall = Wall((True, True, True))
    problem = Problem(constants, ForceControl(force_n, -15.0, 15.0), wall=wall)
    outcome = solve(model, problem).outcome
    assert outcome.converged
    assert (outcome.min_j < 0.3) == squeezed
    assert outcome.squeezed == squeezed
