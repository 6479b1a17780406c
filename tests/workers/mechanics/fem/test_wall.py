"""The chest wall as an elastic foundation."""

import numpy as np
import pytest
from scipy.optimize import fsolve

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.loads_and_regions import (
    EVERYWHERE,
    Box,
    DeadForce,
    NoPlates,
    Pressure,
    Wall,
)
from tests.workers.mechanics.fem.solids import FAR, MIRRORS, body, box, nominal_mpa

SIZE = 10.0


@pytest.mark.parametrize("pressure_mpa", [1e-3, -1e-3])
def test_pressed_block_sinks_into_its_foundation(pressure_mpa):
    """Uniaxial stress, sides free: P_z = -p l^2 with the lateral stretch l.

    Pressure acts on the deformed face and the foundation on the undeformed one, so
    the wall moves by p l^2 / k.
    """
    c, k = Constants(0.01, 0.45), 2e-3
    model = body([(3, 3, 3)], box(SIZE, SIZE, SIZE), jitter=0.2)
    top = Box((-FAR, -FAR, SIZE - 1e-6), (FAR, FAR, FAR))
    problem = Problem(
        {Tissue.FAT: c},
        NoPlates(),
        wall=Wall((False, False, False), (0.0, 0.0, k)),
        holds=MIRRORS,
        pressures=(Pressure(pressure_mpa, top),),
        tolerance_mm=1e-7,
    )
    solution = solve(model, problem)
    assert solution.outcome.converged, solution.outcome.reason

    def out_of_balance(s):
        side, _, along = nominal_mpa(c, s[0], s[0], s[1])
        return side, along + pressure_mpa * s[0] ** 2

    lateral, along = fsolve(out_of_balance, [1.0, 1.0], xtol=1e-13)
    sunk = pressure_mpa * lateral**2 / k
    z = model.finest.nodes[:, 2]
    np.testing.assert_allclose(solution.displacement_mm[:, 2], (along - 1) * z - sunk, atol=1e-4)
    wall_force = SIZE**2 * pressure_mpa * lateral**2
    assert solution.outcome.wall_force_n == pytest.approx(wall_force, rel=1e-4)


def test_stiff_block_shifts_on_tangential_springs():
    """F = k A u; k differs along x and y."""
    kx, ky = 1e-3, 4e-3
    force = (0.02, 0.06, 0.0)
    model = body([(3, 3, 2)], box(SIZE, SIZE, 4.0))
    problem = Problem(
        {Tissue.FAT: Constants(100.0, 0.3)},
        NoPlates(),
        wall=Wall((False, False, True), (kx, ky, 0.0)),
        forces=(DeadForce(force, EVERYWHERE),),
        tolerance_mm=1e-6,
    )
    solution = solve(model, problem)
    assert solution.outcome.converged, solution.outcome.reason
    shift = np.array([0.02 / (kx * SIZE**2), 0.06 / (ky * SIZE**2), 0.0])
    np.testing.assert_allclose(solution.displacement_mm.mean(axis=0), shift, atol=1e-4)
    spread = np.ptp(solution.displacement_mm, axis=0)
    assert spread.max() < 2e-3


def test_foundation_of_a_soft_body_balances_the_force_on_it():
    """The sum of k A_i u_i equals the force, whatever the displacement of the wall."""
    k = 1e-3
    model = body([(3, 3, 2), (6, 6, 4)], box(20.0, 20.0, 10.0), jitter=0.15)
    problem = Problem(
        {Tissue.FAT: Constants(0.003, 0.49)},
        NoPlates(),
        wall=Wall((False, False, True), (k, k, 0.0)),
        forces=(DeadForce((0.05, -0.02, 0.0), EVERYWHERE),),
        tolerance_mm=1e-6,
    )
    solution = solve(model, problem)
    assert solution.outcome.converged, solution.outcome.reason
    fine = model.finest
    u = solution.displacement_mm
    assert np.ptp(u[fine.wall, 0]) > 0.01
    found = (k * fine.wall_areas[:, None] * u).sum(axis=0)
    np.testing.assert_allclose(found[:2], [0.05, -0.02], rtol=1e-5)


def test_very_stiff_foundation_equals_a_held_wall():
    model = body([(3, 3, 3)], box(SIZE, SIZE, SIZE))
    load = DeadForce((0.03, 0.02, 0.05), Box((-FAR, -FAR, SIZE - 1e-6), (FAR, FAR, FAR)))
    found = [
        solve(
            model,
            Problem(
                {Tissue.FAT: Constants(0.01, 0.45)},
                NoPlates(),
                wall=wall,
                forces=(load,),
                tolerance_mm=1e-6,
            ),
        )
        for wall in (Wall((True, True, True)), Wall((False, False, False), (1e3, 1e3, 1e3)))
    ]
    held, sprung = found
    assert np.abs(held.displacement_mm).max() > 0.5
    np.testing.assert_allclose(sprung.displacement_mm, held.displacement_mm, atol=1e-4)
    assert held.outcome.wall_force_n == pytest.approx(-0.05, rel=1e-5)
    assert sprung.outcome.wall_force_n == pytest.approx(-0.05, rel=1e-4)
