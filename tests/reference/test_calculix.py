"""Our plain elements against CalculiX under various loads.

Our solver prevents drift with springs of 5e-9 N/mm^4, which the CalculiX model lacks; their
effect must be negligible. Loads of the stiff body are scaled with its stiffness, so that it
deforms as much as a soft one.
"""

import numpy as np
import pytest

from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Problem, Solution
from palpate.workers.mechanics.fem.loads_and_regions import (
    Box,
    DeadForce,
    DistanceControl,
    Hold,
    NoPlates,
    Pressure,
    Wall,
)
from palpate.workers.mechanics.fem.plate_contact import PENALTY_N_PER_MM3
from tests.reference.bodies import SIDE_MM, Block, block
from tests.reference.calculix import Answer, Body, Held, Springs, available
from tests.reference.calculix import solve as calculix

pytestmark = pytest.mark.skipif(
    not available(), reason="CalculiX is not installed (Debian: apt install calculix-ccx)"
)

TOP = Box((-1, SIDE_MM - 1e-3, -1), (SIDE_MM + 1, SIDE_MM + 1e-3, SIDE_MM + 1))
CLAMPED = Wall(held=(True, True, True))
LOOSE = (False, False, False)


@pytest.fixture(scope="module")
def soft() -> Block:
    return block(0.01)


@pytest.fixture(scope="module")
def stiff() -> Block:
    return block(1.0)


def ours(body: Block, load=NoPlates(), **options) -> Solution:  # noqa: B008
    problem = Problem(body.constants, load, plain_elements=True, tolerance_mm=1e-6, **options)
    solution = solve(body.model, problem)
    assert solution.outcome.converged, solution.outcome.reason
    return solution


def wall(body: Block, *axes: int) -> tuple[Held, ...]:
    return tuple(Held(body.face(2, 0.0), axis) for axis in axes)


def plate(body: Block, at_mm: float, moved_mm: float) -> Springs:
    """Return a plate on a face normal to y; a node's penalty counts the area of all free sides."""
    free = [body.triangles(axis, at) for axis in (0, 1, 2) for at in (0.0, SIDE_MM)]
    del free[4]  # the chest wall
    area = body.areas_mm2(np.concatenate(free))
    nodes = body.face(1, at_mm)
    return Springs(nodes, 1, PENALTY_N_PER_MM3 * area[nodes], moved_mm)


def assert_same(solution: Solution, answer: Answer, within_mm: float = 1e-4) -> None:
    """Compare the mean distance of the nodes, for bodies that move by millimetres."""
    away = np.linalg.norm(solution.displacement_mm - answer.displacement_mm, axis=1)
    assert np.abs(answer.displacement_mm).max() > 3
    assert away.mean() < within_mm
    assert away.max() < 5 * within_mm


def test_plates_match_calculix(soft: Block) -> None:
    solution = ours(soft, DistanceControl(0, 28), wall=Wall(held=(True, False, True)))
    answer = calculix(
        Body(
            soft.mesh,
            soft.materials,
            wall(soft, 0, 2),
            (plate(soft, 0, 0), plate(soft, SIDE_MM, 28 - SIDE_MM)),
        )
    )
    assert_same(solution, answer)
    lower, upper = answer.ground_n
    assert solution.outcome.plate_force_n == pytest.approx(-upper, rel=1e-5)
    assert lower == pytest.approx(-upper, rel=1e-6)


def test_gravity_matches_calculix(stiff: Block) -> None:
    g = (60.0, -150.0, 80.0)
    solution = ours(stiff, wall=CLAMPED, gravity_g=g)
    answer = calculix(Body(stiff.mesh, stiff.materials, wall(stiff, 0, 1, 2), gravity_g=g))
    assert_same(solution, answer)
    weight_n = g[2] * 9806.65 * 1e-9 * SIDE_MM**3
    assert solution.outcome.wall_force_n == pytest.approx(-weight_n, rel=1e-4)


def test_moved_face_matches_calculix(stiff: Block) -> None:
    moved = (4.0, -6.0, 2.0)
    off_wall = Box((-1, SIDE_MM - 1e-3, 1e-3), TOP.upper_mm)
    solution = ours(stiff, wall=CLAMPED, holds=(Hold(off_wall, moved),))
    top = np.setdiff1d(stiff.face(1, SIDE_MM), stiff.face(2, 0.0))
    held = tuple(Held(top, axis, value) for axis, value in enumerate(moved))
    answer = calculix(Body(stiff.mesh, stiff.materials, wall(stiff, 0, 1, 2) + held))
    assert_same(solution, answer)


def test_follower_pressure_matches_calculix(stiff: Block) -> None:
    solution = ours(stiff, wall=CLAMPED, pressures=(Pressure(0.06, TOP),))
    answer = calculix(
        Body(
            stiff.mesh,
            stiff.materials,
            wall(stiff, 0, 1, 2),
            pressure_mpa=0.06,
            pressed=stiff.triangles(1, SIDE_MM),
        )
    )
    assert_same(solution, answer)


def test_force_and_elastic_wall_match_calculix(stiff: Block) -> None:
    force, foundation = np.array([60.0, -90.0, 150.0]), (0.08, 0.12, 0.16)
    solution = ours(
        stiff,
        wall=Wall(held=LOOSE, spring_mpa_per_mm=foundation),
        forces=(DeadForce(tuple(force), TOP),),
    )
    top, back = stiff.face(1, SIDE_MM), stiff.face(2, 0.0)
    forces = np.zeros_like(stiff.mesh.nodes)
    forces[top] = force / len(top)
    area = stiff.areas_mm2(stiff.triangles(2, 0.0))[back]
    springs = tuple(Springs(back, axis, k * area) for axis, k in enumerate(foundation))
    answer = calculix(Body(stiff.mesh, stiff.materials, springs=springs, forces_n=forces))
    assert_same(solution, answer)
    np.testing.assert_allclose(answer.ground_n, -force, rtol=1e-5)
