"""The same equilibrium by other paths: in stages, and from a nearby problem."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem import load_path
from palpate.workers.mechanics.fem.body_equilibrium import equilibrium, solve
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Constants, Problem
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.mechanics.fem.equilibrium_sensitivity import tangents
from palpate.workers.mechanics.fem.load_path import load_schedules
from palpate.workers.mechanics.fem.loads_and_regions import (
    Device,
    DistanceControl,
    ForceControl,
    Plate,
    Wall,
)
from tests.workers.mechanics.fem.blocks import cube, model_of

FAT = {Tissue.FAT: Constants(0.01, 0.49, 0.03)}
HELD = Wall((False, False, True), (1e-4, 0.0, 0.0))


def _schedules_from(first: int) -> Callable[..., list[Any]]:
    """Return the schedules of the load without those before `first`."""
    return lambda *args: list(load_schedules(*args))[first:]


@pytest.fixture(scope="module")
def model() -> Model:
    return model_of(cube(3), cube(6, jitter=0.15))


def pressed(friction: float = 0.0, tilt_deg: float = 0.0) -> Problem:
    device = Device(pivot_mm=(5, 5, 5), upper=Plate((tilt_deg, 0.0)), friction=friction)
    load = ForceControl(0.3, 0.0, 10.0, device)
    return Problem(FAT, load, wall=HELD, tolerance_mm=1e-6)


@pytest.mark.parametrize("load", [ForceControl(0.3, 0.0, 10.0), DistanceControl(0.0, 8.0)])
@pytest.mark.parametrize("route", [1, 2])
def test_more_stages_give_the_same_solution(model, monkeypatch, load, route):
    problem = replace(pressed(), load=load)
    direct = solve(model, problem)
    monkeypatch.setattr(load_path, "load_schedules", _schedules_from(route))
    staged = solve(model, problem)
    assert staged.outcome.converged
    np.testing.assert_allclose(staged.displacement_mm, direct.displacement_mm, atol=1e-5)


def test_failed_schedule_is_followed_by_more_stages(model, monkeypatch):
    """The direct schedule is made to fail on the finest mesh; the next one is used."""
    tried: list[float] = []

    def stubborn(level, start, stage, *rest):
        found = solve_balanced(level, start, stage, *rest)
        if level.model is model.finest:
            tried.append(stage.fraction)
            if len(tried) == 1:
                return replace(found, reason="made to fail")
        return found

    direct = solve(model, pressed())
    solve_balanced = load_path.solve_balanced
    monkeypatch.setattr(load_path, "solve_balanced", stubborn)
    found = solve(model, pressed())
    assert found.outcome.converged
    assert tried == pytest.approx([1.0, 1 / 9, 4 / 9, 1.0])
    np.testing.assert_allclose(found.displacement_mm, direct.displacement_mm, atol=1e-5)


@pytest.mark.parametrize(("near", "wanted"), [(0.3, 0.35), (0.3, 0.3), (0.0, 0.3)])
def test_start_from_a_nearby_problem_gives_the_same_solution_with_friction(model, near, wanted):
    """Friction is kept, and its path is followed again."""
    start = equilibrium(model, pressed(near))
    continued = equilibrium(model, pressed(wanted, tilt_deg=1.0), start).solution
    rested = solve(model, pressed(wanted, tilt_deg=1.0))
    assert continued.outcome.converged
    apart = np.abs(continued.displacement_mm - rested.displacement_mm).max()
    assert apart < 1e-4
    free = solve(model, pressed(0.0, tilt_deg=1.0))
    assert np.abs(free.displacement_mm - rested.displacement_mm).max() > 0.05


def test_expected_motion_saves_iterations_only(model):
    """Half a degree of tilt along its tangent; an absurd motion is ignored."""
    start = equilibrium(model, pressed(tilt_deg=1.0))
    wanted = pressed(tilt_deg=1.5)
    change = Change(pressed(tilt_deg=1.01), pressed(tilt_deg=0.99), 0.02)
    (along,) = tangents(start, [change])
    plain = equilibrium(model, wanted, start).solution
    expected = equilibrium(model, wanted, start.expecting(0.5 * along)).solution
    absurd = equilibrium(model, wanted, start.expecting(-40.0 * along)).solution
    assert expected.outcome.newton_iterations[-1] < plain.outcome.newton_iterations[-1]
    assert absurd.outcome.newton_iterations == plain.outcome.newton_iterations
    np.testing.assert_allclose(expected.displacement_mm, plain.displacement_mm, atol=1e-5)
    np.testing.assert_allclose(absurd.displacement_mm, plain.displacement_mm, atol=1e-9)


def test_expected_motion_is_ignored_with_friction_steps(model):
    start = equilibrium(model, pressed(0.3))
    assert start.expecting(np.ones_like(start.states[-1].x)) is start


@pytest.mark.parametrize(
    ("near", "wanted", "route"),
    [(0.3, 0.35, 1), (0.0, 0.0, 1), pytest.param(0.3, 0.35, 2, marks=pytest.mark.slow)],
)
def test_load_stages_of_a_nearby_problem_are_reused(model, monkeypatch, near, wanted, route):
    """If its direct schedule failed, a similar body's would hardly succeed."""
    problem = replace(pressed(wanted, tilt_deg=1.0), tolerance_mm=2e-3)
    neighbour = replace(pressed(near), tolerance_mm=2e-3)
    with monkeypatch.context() as patch:
        patch.setattr(load_path, "load_schedules", _schedules_from(route))
        start, rested = equilibrium(model, neighbour), equilibrium(model, problem)
    monkeypatch.setattr(
        load_path.LoadStepping, "from_rest", lambda *_: pytest.fail("began from rest")
    )
    continued = equilibrium(model, problem, start)
    assert len(continued.path) == len(start.path) == len(rested.path) > 1
    apart = continued.solution.displacement_mm - rested.solution.displacement_mm
    assert np.abs(apart).max() < 5e-3


def test_start_from_a_nearby_problem_saves_newton_iterations(model):
    start = equilibrium(model, pressed())
    near = replace(pressed(), constants={Tissue.FAT: Constants(0.0105, 0.49, 0.03)})
    continued, rested = equilibrium(model, near, start).solution, solve(model, near)
    np.testing.assert_allclose(continued.displacement_mm, rested.displacement_mm, atol=1e-5)
    assert sum(continued.outcome.newton_iterations) < sum(rested.outcome.newton_iterations)


def test_failure_from_a_nearby_problem_is_final_without_restarts(model, monkeypatch):
    """The continuation is cut short; from rest the same body converges."""
    start = equilibrium(model, pressed())
    tilted = pressed(tilt_deg=6.0)
    direct = solve(model, tilted)
    monkeypatch.setattr(load_path, "MAX_ITERATIONS_FROM_NEIGHBOUR", 1)
    found = equilibrium(model, tilted, start).solution
    assert found.outcome.converged
    np.testing.assert_allclose(found.displacement_mm, direct.displacement_mm, atol=1e-5)
    given_up = equilibrium(model, replace(tilted, restarts=False), start).solution.outcome
    assert not given_up.converged
    assert "1 Newton iterations" in given_up.reason
    assert equilibrium(model, replace(tilted, restarts=False)).solution.outcome.converged
