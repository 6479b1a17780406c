"""Levels are immutable: results do not depend on earlier computations."""

from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Constants, Problem
from palpate.workers.mechanics.fem.discretisation import Model, State
from palpate.workers.mechanics.fem.equilibrium_sensitivity import tangents
from palpate.workers.mechanics.fem.loads_and_regions import (
    Device,
    ForceControl,
    NoPlates,
    Pressure,
    Wall,
)
from palpate.workers.mechanics.fem.mesh_level import Level
from tests.workers.mechanics.fem.blocks import cube, model_of

FAT = {Tissue.FAT: Constants(0.01, 0.49, 0.03)}
WALL = Wall((False, False, True), (1e-4, 0.0, 0.0))


def pressed(friction: float) -> Problem:
    load = ForceControl(0.3, 0.0, 10.0, Device(pivot_mm=(5, 5, 5), friction=friction))
    return Problem(FAT, load, wall=WALL)


PROBLEMS = {
    "plates": pressed(0.0),
    "friction": pressed(0.3),
    "pressure": Problem(
        FAT, NoPlates(), wall=Wall((True, True, True)), pressures=(Pressure(5e-4),)
    ),
}


@pytest.fixture(scope="module")
def model() -> Model:
    return model_of(cube(3), cube(6, jitter=0.15))


def stiffer(problem: Problem, factor: float) -> Problem:
    constants = {t: replace(c, young_mpa=factor * c.young_mpa) for t, c in FAT.items()}
    return replace(problem, constants=constants)


def other_work(at: Equilibrium) -> None:
    """Compute tangents for another parameter and start, and a similar problem's equilibrium."""
    problem = at.problem
    gravity = Change(replace(problem, gravity_g=(0.0, 0.01, 0.0)), problem, 0.01)
    tangents(at, [gravity])
    if problem.load.device.friction == 0 and isinstance(problem.load, ForceControl):
        rough = replace(problem.load, device=replace(problem.load.device, friction=0.01))
        tangents(at, [Change(replace(problem, load=rough), problem, 0.01)])
    equilibrium(at.imaged, stiffer(problem, 1.1), at)


@pytest.mark.parametrize("kind", PROBLEMS)
def test_tangent_does_not_depend_on_earlier_computations(model, kind):
    """Results are bit-identical: the smoother's power iteration starts from the same vector."""
    problem = PROBLEMS[kind]
    at = equilibrium(model, problem)
    assert at.solution.outcome.converged, at.solution.outcome.reason
    change = [Change(stiffer(problem, 1.001), stiffer(problem, 0.999), 0.002)]
    first = tangents(at, change)
    other_work(at)
    assert np.abs(first).max() > 1e-3
    assert np.array_equal(tangents(at, change), first)


@pytest.mark.parametrize("name", [f.name for f in fields(Level)] + ["grips"])
def test_attributes_of_a_level_cannot_be_assigned(model, name):
    level = Level.build(model.finest, PROBLEMS["friction"])
    with pytest.raises(FrozenInstanceError):
        setattr(level, name, getattr(level, name, None))


def test_step_returns_a_new_state(model):
    """Friction and follower pressure are in the returned history."""
    problem = replace(PROBLEMS["friction"], pressures=(Pressure(1e-4),))
    level = Level.build(model.finest, problem)
    stage = equilibrium(model, pressed(0.3)).stage
    start = State(model.finest.nodes * [1.0, 0.95, 1.0], 0.8)
    begun = level.begin_step(start, stage)
    updated = level.update_history(begun.moved_to(start.x * [1.0, 0.99, 1.0], 0.9), stage)
    assert start.history.friction == ()
    assert start.history.follower_force is None
    assert begun.history.follower_force is None
    assert len(begun.history.friction) == 2
    before, after = (h.history.friction[1].normal_force.sum() for h in (begun, updated))
    assert after != before
    assert updated.history.follower_force is not None
