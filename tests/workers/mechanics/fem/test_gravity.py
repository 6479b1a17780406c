"""Bodies under their own weight."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import (
    GRAVITY_MM_PER_S2,
    Constants,
    FibreField,
    Problem,
)
from palpate.workers.mechanics.fem.loads_and_regions import EVERYWHERE, Hold, NoPlates, Wall
from tests.workers.mechanics.fem.solids import body, box, nominal_mpa, rotation, turned

HEIGHT = 80.0
CLAMPED = Wall(held=(True, True, True))
SIDES_HELD = Hold(EVERYWHERE, axes=(True, True, False))
WATER = 1e-9


def column(layers: int):
    return body([(2, 2, layers)], box(20.0, 20.0, HEIGHT))


def sag(c: Constants, g: float, z: np.ndarray) -> np.ndarray:
    """Return the displacement of a column that cannot bulge, with gravity `g` along z.

    Equilibrium dP/dz + rho g = 0 with P(HEIGHT) = 0 gives P(z) = rho g (HEIGHT - z),
    the law gives the stretch that carries P, and u' = stretch - 1.
    """
    at = np.linspace(0, HEIGHT, 4001)
    weight = c.density_t_per_mm3 * GRAVITY_MM_PER_S2 * g * (HEIGHT - at)
    stretch = [brentq(lambda l, p=p: nominal_mpa(c, 1, 1, l)[2] - p, 0.1, 9) for p in weight]
    u = cumulative_trapezoid(np.asarray(stretch) - 1, at, initial=0)
    return np.interp(z, at, u)


def column_error(c: Constants, g: float, layers: int, **options: object) -> float:
    """Return the largest error of a layer's mean displacement, over the largest displacement."""
    model = column(layers)
    problem = Problem(
        {Tissue.FAT: c},
        NoPlates(),
        holds=(SIDES_HELD,),
        gravity_g=(0, 0, g),
        tolerance_mm=1e-6,
        **options,
    )
    solution = solve(model, problem)
    assert solution.outcome.converged, solution.outcome.reason
    u = solution.displacement_mm[:, 2].reshape(-1, layers + 1).mean(axis=0)
    exact = sag(c, g, np.linspace(0, HEIGHT, layers + 1))
    return float(np.abs(u - exact).max() / np.abs(exact).max())


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize(("nu", "g"), [(0.3, -1.0), (0.3, 0.6), (0.49, -20.0)])
def test_column_sags_by_its_own_weight(nu, g, plain):
    """Finite uniaxial strain: up to 45 % at the foot. The error falls as h^2."""
    c = Constants(0.001, nu)
    coarse, fine = (column_error(c, g, n, plain_elements=plain) for n in (8, 16))
    assert fine < 0.006
    assert np.log2(coarse / fine) > 1.7


def test_small_sag_is_the_parabola_of_linear_elasticity():
    """u(z) = rho g (2 H z - z^2) / (2 M), M = kappa + 4/3 mu: the exact column for small g."""
    c = Constants(0.01, 0.4)
    z = np.linspace(0, HEIGHT, 9)
    M = c.kappa_mpa + 4 / 3 * c.mu_mpa
    g = 1e-3
    linear = WATER * GRAVITY_MM_PER_S2 * g * (2 * HEIGHT * z - z**2) / (2 * M)
    np.testing.assert_allclose(sag(c, g, z), linear, rtol=1e-4)


@pytest.mark.parametrize("wall", [CLAMPED, Wall((True, True, False), (0.0, 0.0, 1e-3))])
def test_wall_carries_the_weight(wall):
    """Held or on springs, its reaction balances the weight."""
    c = Constants(0.01, 0.49, density_t_per_mm3=2 * WATER)
    weight = 2 * WATER * GRAVITY_MM_PER_S2 * 20 * 20 * HEIGHT
    problem = Problem({Tissue.FAT: c}, NoPlates(), wall=wall, gravity_g=(0, 0, 1))
    outcome = solve(column(6), problem).outcome
    assert outcome.converged, outcome.reason
    assert outcome.wall_force_n == pytest.approx(-weight, rel=1e-5)


def test_rotated_body_and_gravity_give_the_rotated_solution():
    c = Constants(0.002, 0.49, fibre_mpa=0.004)
    R = rotation((1.0, 2.0, 0.5), 50.0)
    g, axis = np.array([0.4, -0.7, 0.5]), np.array([0.2, 0.3, 1.0])
    found = []
    for Q in (np.eye(3), R):
        problem = Problem(
            {Tissue.FAT: c},
            NoPlates(),
            wall=CLAMPED,
            fibres=FibreField(tuple(Q @ axis)),
            gravity_g=tuple(Q @ g),
            tolerance_mm=1e-7,
        )
        model = body([(2, 2, 5)], turned(box(20.0, 20.0, 40.0), Q), jitter=0.2)
        found.append(solve(model, problem).displacement_mm)
    assert np.abs(found[0]).max() > 1.0
    np.testing.assert_allclose(found[1], found[0] @ R.T, atol=1e-6)
