"""Convergence of our default element: its limit and its order.

No other program has our nodal average. With mesh refinement its solution must tend to that of
other locking-free elements, at the order of linear elements: 2 in the displacement of a smooth
solution, and in the energy.
"""

import numpy as np
import pytest

from palpate.storage.values import FloatArray, Tissue
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, build_hierarchy
from palpate.workers.body.mesh.nodal_interpolation import prolongation
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem, Solution
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.mechanics.fem.loads_and_regions import Box, ForceControl, Hold, NoPlates, Wall
from tests.reference.bodies import SIDE_MM, half_ellipsoid
from tests.workers.mechanics.fem.blocks import cube, level_of

TISSUE = Constants(0.1, 0.49)
GRAVITY_G = (0.0, -60.0, 0.0)
FLOOR = Box((-1, -1e-3, -1), (SIDE_MM + 1, 1e-3, SIDE_MM + 1))
CELLS = (3, 6, 12, 24)
NODES = (800, 2400, 7200)


def order(size: FloatArray, error: FloatArray) -> float:
    """Return the slope of log error over log size, by least squares."""
    return float(np.polyfit(np.log(size), np.log(error), 1)[0])


def slumped() -> list[tuple[FloatArray, FloatArray]]:
    """Solve a block under its weight on a slippery floor; nodes and displacement of each mesh."""
    problem = Problem(
        {Tissue.FAT: TISSUE},
        NoPlates(),
        wall=Wall(held=(False, False, True)),
        holds=(Hold(FLOOR, axes=(False, True, False)),),
        gravity_g=GRAVITY_G,
        tolerance_mm=1e-6,
    )
    levels, found = [], []
    for cells in CELLS:
        level = level_of(cube(cells, side=SIDE_MM))
        if levels:
            below = levels[-1]
            transfer = prolongation(below.mesh, below.wall, level.mesh.nodes, level.wall)
            level = level_of(level.mesh, prolongation=transfer)
        levels.append(level)
        solution = solve(prepare(Hierarchy(tuple(levels))), problem)
        assert solution.outcome.converged, solution.outcome.reason
        found.append((level.mesh.nodes, solution.displacement_mm))
    return found


def slumped_hexahedra(cells: int) -> tuple[FloatArray, FloatArray]:
    """Solve the same block with FElupe's hexahedra with separate pressure."""
    felupe = pytest.importorskip("felupe", reason="FElupe is not installed (pip install felupe)")
    from tests.reference.felupe_body import solve_hexahedra

    mesh = felupe.Cube(b=(SIDE_MM,) * 3, n=cells + 1)
    held = np.full(mesh.points.shape, np.nan)
    held[mesh.points[:, 2] < 1e-9, 2] = 0
    held[mesh.points[:, 1] < 1e-9, 1] = 0
    held[0, 0] = 0
    answer = solve_hexahedra(mesh, TISSUE.mu_mpa, TISSUE.kappa_mpa, held, GRAVITY_G)
    return mesh.points, answer.displacement_mm


def at_coarsest(nodes: FloatArray, moved: FloatArray) -> FloatArray:
    """Return the displacement at the nodes shared by all meshes, sorted, without drift along x."""
    steps = nodes * CELLS[0] / SIDE_MM
    shared = np.flatnonzero((np.abs(steps - steps.round()) < 1e-6).all(axis=1))
    moved = moved[shared[np.lexsort(steps[shared].round().T)]]
    return moved - moved.mean(axis=0) * [1, 0, 0]


@pytest.mark.slow
def test_smooth_displacement_converges_to_mixed_hexahedra() -> None:
    """Their own error falls with the square of the cell size and is extrapolated."""
    coarse, fine = (at_coarsest(*slumped_hexahedra(cells)) for cells in (6, 9))
    truth = fine + (fine - coarse) / ((9 / 6) ** 2 - 1)
    error = np.array(
        [np.linalg.norm(at_coarsest(*mesh) - truth, axis=1).mean() for mesh in slumped()]
    )
    assert np.abs(truth).max() > 4
    assert (np.diff(error) < 0).all()
    assert error[-1] < 0.015
    assert 1.5 < order(1 / np.array(CELLS), error) < 2.5


def pressed(nodes: int) -> Solution:
    """Solve a half ellipsoid of one tissue under 15 N."""
    model = prepare(build_hierarchy(half_ellipsoid(core=0.0), nodes=nodes))
    solution = solve(
        model, Problem({Tissue.FAT: Constants(0.01)}, ForceControl(15, -30, 30), tolerance_mm=1e-4)
    )
    assert solution.outcome.converged, solution.outcome.reason
    return solution


@pytest.mark.slow
def test_plate_and_energy_of_a_curved_body_converge() -> None:
    """The meshes are not nested, and the contact area grows with the load."""
    *coarser, finest = (pressed(nodes) for nodes in (*NODES, 3 * NODES[-1]))
    size = np.array([len(s.displacement_mm) for s in coarser]) ** (-1 / 3)
    travel, energy = (
        np.array([abs(getattr(s.outcome, of) - getattr(finest.outcome, of)) for s in coarser])
        for of in ("plate_displacement_mm", "energy_mj")
    )
    assert (np.diff(travel) < 0).all()
    assert (np.diff(energy) < 0).all()
    assert order(size, travel) > 1.5
    assert order(size, energy) > 1.5
    assert travel[-1] < 5e-4 * finest.outcome.plate_displacement_mm
