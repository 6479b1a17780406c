"""Tubes and hollow spheres under internal pressure: Lame's solution and the finite one."""

import numpy as np
from scipy.integrate import solve_bvp

from tests.workers.organs.cornea.solver.ogden_energy import nominal_stress, young_and_poisson


def lame_tube(R, a, b, pressure, constants):
    """Return the radial displacement of a tube in plane strain at small strain."""
    E, nu = young_and_poisson(constants)
    return (1 + nu) / E * pressure * a**2 / (b**2 - a**2) * ((1 - 2 * nu) * R + b**2 / R)


def lame_sphere(R, a, b, pressure, constants):
    """Return the radial displacement of a sphere at small strain."""
    E, nu = young_and_poisson(constants)
    factor = pressure * a**3 / (E * (b**3 - a**3))
    return factor * ((1 - 2 * nu) * R + (1 + nu) * b**3 / (2 * R**2))


def finite_radius(a, b, pressure, constants, sphere):
    """Return r(R) of a tube in plane strain or a sphere, from its differential equation.

    With the nominal stress P, dP_r/dR = -k (P_r - P_t)/R, P_r = -p (r/R)^k inside and 0
    outside; k = 1 for a tube, 2 for a sphere.
    """
    k = 2 if sphere else 1

    def stress(radial, hoop):
        axial = hoop if sphere else np.ones_like(hoop)
        return nominal_stress(np.stack([radial, hoop, axial], axis=-1), constants)

    def slope(R, y):
        hoop = y[0] / R
        radial = 1 / hoop
        for _ in range(60):
            P, h = stress(radial, hoop)[..., 0], 1e-6
            slope_P = (stress(radial + h, hoop)[..., 0] - stress(radial - h, hoop)[..., 0]) / 2 / h
            change = (P - y[1]) / slope_P
            radial = radial - change
            if np.abs(change).max() < 1e-14:
                break
        P = stress(radial, hoop)
        return np.stack([radial, -k * (P[..., 0] - P[..., 1]) / R])

    def ends(inner, outer):
        return np.array([inner[1] + pressure * (inner[0] / a) ** k, outer[1]])

    R = np.linspace(a, b, 41)
    guess = np.stack([R * 1.001, -pressure * (b - R) / (b - a)])
    solution = solve_bvp(slope, ends, R, guess, tol=1e-9, max_nodes=20000)
    assert solution.success
    return lambda R: solution.sol(R)[0]
