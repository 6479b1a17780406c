"""Follower pressure."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.element_energy import deformation_gradients
from palpate.workers.mechanics.fem.external_forces import pressure_derivative, pressure_forces
from palpate.workers.mechanics.fem.loads_and_regions import Ball, Box, NoPlates, Pressure
from tests.workers.mechanics.fem.solids import MIRRORS, ball, body, box, symmetric


@pytest.mark.parametrize("pressure_mpa", [0.008, -0.008])
def test_uniform_pressure_changes_only_the_volume(pressure_mpa):
    """W = kappa/2 (J-1)^2 gives sigma = kappa (J-1) 1, so J = 1 - p / kappa everywhere."""
    c = Constants(0.05, 0.3)
    model = body([(3, 3, 3)], box(10.0, 12.0, 9.0), jitter=0.2, bare=symmetric)
    problem = Problem(
        {Tissue.FAT: c},
        NoPlates(),
        holds=MIRRORS,
        pressures=(Pressure(pressure_mpa),),
        tolerance_mm=1e-6,
    )
    solution = solve(model, problem)
    assert solution.outcome.converged, solution.outcome.reason
    F = deformation_gradients(model.finest.nodes + solution.displacement_mm, model.finest.elements)
    J = 1 - pressure_mpa / c.kappa_mpa
    np.testing.assert_allclose(np.linalg.det(F), J, rtol=1e-5)
    stretch = np.swapaxes(F, 1, 2) @ F
    np.testing.assert_allclose(
        stretch, np.broadcast_to(J ** (2 / 3) * np.eye(3), F.shape), atol=1e-5
    )


@pytest.mark.slow
def test_overlapping_regions_add_up():
    model = body([(3, 3, 3)], box(10.0, 10.0, 10.0), wall=False)
    c = {Tissue.FAT: Constants(0.05, 0.3)}
    whole = (Pressure(0.01),)
    upper = Box((-1.0, -1.0, 4.0), (11.0, 11.0, 11.0))
    parts = (Pressure(0.004), Pressure(0.006, upper), Pressure(0.006), Pressure(-0.006, upper))
    found = [solve(model, Problem(c, NoPlates(), pressures=p)) for p in (whole, parts)]
    np.testing.assert_allclose(found[0].displacement_mm, found[1].displacement_mm, atol=1e-9)


def test_force_is_minus_pressure_times_the_gradient_of_the_volume():
    """For a closed surface the work of pressure is -p dV, and its resultant is zero."""
    level = body([(3, 3, 3)], box(10.0, 10.0, 10.0), wall=False).finest
    rng = np.random.default_rng(5)
    x = level.nodes + rng.uniform(-1, 1, level.nodes.shape)
    u = rng.standard_normal(x.shape)
    pressures = (Pressure(0.03),)

    def volume(at):
        corner = at[level.elements.tets]
        return float(np.linalg.det(corner[:, 1:] - corner[:, :1]).sum() / 6)

    force, h = pressure_forces(level, x, pressures), 1e-4
    slope = (volume(x + h * u) - volume(x - h * u)) / (2 * h)
    assert np.vdot(force, u) == pytest.approx(-0.03 * slope, rel=1e-7)
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-12)
    ahead, behind = (pressure_forces(level, x + s * h * u, pressures) for s in (1, -1))
    np.testing.assert_allclose(
        pressure_derivative(level, x, pressures, u), (ahead - behind) / (2 * h), atol=1e-9
    )


def shell_pressure(mu: float, inside: float, outside: float) -> float:
    r"""Return the pressure that inflates a thick incompressible neo-Hookean shell.

    sigma_t - sigma_r = mu (l^2 - l^-4), equilibrium along r and r^3 - R^3 = const give
    ``p = int_{l_b}^{l_a} 2 mu (l^3 + 1) / l^5 dl
    = mu/2 (4/l_b + l_b^-4 - 4/l_a - l_a^-4)`` (Green & Zerna 1954; Ogden 1984, 5.3.2)
    for the stretches l_a of the inner and l_b of the outer surface.
    """

    def part(l: float) -> float:
        return 4 / l + l**-4

    return mu / 2 * (part(outside) - part(inside))


def test_closed_form_of_the_shell_equals_its_integral():
    found, _ = quad(lambda l: 2 * 0.01 * (l**3 + 1) / l**5, 1.05, 1.4)
    assert shell_pressure(0.01, 1.4, 1.05) == pytest.approx(found, rel=1e-12)


def test_inflated_thick_shell_matches_the_closed_form():
    """An eighth of a shell, radii 20 and 40 mm; the inner radius grows by about a quarter."""
    c = Constants(0.01, 0.4995)
    inner, outer, pressure_mpa = 20.0, 40.0, 0.0018

    def missing(stretch: float) -> float:
        far = np.cbrt(1 + (stretch**3 - 1) * (inner / outer) ** 3)
        return shell_pressure(c.mu_mpa, stretch, far) - pressure_mpa

    exact = brentq(missing, 1.0, 2.0)
    assert 1.2 < exact < 1.35
    found = []
    for n in (4, 8):
        hollow = 0.5
        model = body([(n, n, n)], ball(outer, inner, hollow), hollow=hollow, bare=symmetric)
        problem = Problem(
            {Tissue.FAT: c},
            NoPlates(),
            holds=MIRRORS,
            pressures=(Pressure(pressure_mpa, Ball((0.0, 0.0, 0.0), inner + 1.0)),),
        )
        solution = solve(model, problem)
        assert solution.outcome.converged, solution.outcome.reason
        X = model.finest.nodes
        at = np.abs(np.linalg.norm(X, axis=1) - inner) < 1e-6
        x = (X + solution.displacement_mm)[at]
        found.append(float(np.linalg.norm(x, axis=1).mean() / inner))
    coarse, fine = found
    assert 1.7 < np.log2((coarse - exact) / (fine - exact)) < 2.5
    assert (4 * fine - coarse) / 3 - 1 == pytest.approx(exact - 1, rel=0.015)
