"""Tubes and spheres under pressure against exact solutions, and the order of convergence."""

import numpy as np
import pytest

from palpate.workers.mechanics.triangles import shape_functions
from palpate.workers.organs.cornea.cornea_equations import Stage, follow, system_of
from palpate.workers.organs.cornea.cornea_problem import prepare
from palpate.workers.organs.cornea.corneal_model import (
    QUADRATURE,
    CorneaConstants,
    CorneaLoad,
    CorneaModel,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import NO_LOAD
from tests.workers.organs.cornea.solver.radial_solutions import (
    finite_radius,
    lame_sphere,
    lame_tube,
)
from tests.workers.organs.cornea.solver.structured_t6 import mapped

INNER, OUTER = 5.0, 7.5
X1 = CorneaConstants((0.011, 0.035), (30.0, 80.0))
BODIES = {"plane strain": lame_tube, "axisymmetric": lame_sphere}


def quarter_ring(around, across):
    """Return a mesh from the y axis to the x axis: a quarter of a tube or half a sphere."""
    angle = np.linspace(0, np.pi / 2, 2 * around + 1)
    radius = np.linspace(INNER, OUTER, 2 * across + 1)
    T, R = np.meshgrid(angle, radius, indexing="ij")
    nodes = np.stack([R * np.sin(T), R * np.cos(T)], axis=-1)
    nodes[np.abs(nodes) < 1e-12] = 0.0
    return mapped(nodes, around, across)


def inflated(mesh, kind, pressure, constants, points=3):
    """Return the displacement under internal pressure, symmetric about both axes."""
    model = CorneaModel(kind=kind, prestress="none", quadrature_points=points, tolerance_mm=1e-11)
    prepared = prepare(mesh, model, held=np.abs(mesh.nodes_mm) < 1e-12)
    jet_centre_mm = 0.0 if kind == "axisymmetric" else 3.0  # inactive, but it must fit
    system = system_of(prepared, constants, CorneaLoad(pressure, 0.0, jet_centre_mm))
    path = follow(system, np.zeros_like(mesh.nodes_mm), NO_LOAD, Stage(pressure, 0.0, 0.0), 0.5)
    assert path.reason == ""
    return path.u


def error_mm(mesh, u, radial):
    """Return the RMS distance from a radial displacement, inside the triangles."""
    points, weights = QUADRATURE[7]
    N, _ = shape_functions(points)
    x, v = N @ mesh.nodes_mm[mesh.triangles], N @ u[mesh.triangles]
    R = np.linalg.norm(x, axis=-1, keepdims=True)
    squares = ((v - radial(R) * x / R) ** 2).sum(axis=-1)
    return np.sqrt((squares @ weights).mean() / weights.sum())


@pytest.mark.parametrize("kind", BODIES)
def test_small_pressure_matches_the_lame_solution(kind):
    mesh = quarter_ring(16, 6)
    pressure = 1e-6
    u = inflated(mesh, kind, pressure, X1)

    def exact(R):
        return BODIES[kind](R, INNER, OUTER, pressure, X1)

    assert error_mm(mesh, u, exact) < 1e-4 * exact(INNER)


@pytest.mark.parametrize("kind", BODIES)
@pytest.mark.parametrize("points", [3, 7])
def test_finite_pressure_matches_the_radial_solution(kind, points):
    """Hoop strains of 4 to 5 %, at which the law of X1 is several times stiffer than at rest."""
    mesh = quarter_ring(24, 8)
    pressure = 0.2
    r = finite_radius(INNER, OUTER, pressure, X1, kind == "axisymmetric")
    inner = r(INNER) - INNER
    linear = BODIES[kind](INNER, INNER, OUTER, pressure, X1)
    assert inner / INNER > 0.02
    assert abs(inner - linear) > 0.05 * inner
    u = inflated(mesh, kind, pressure, X1, points)
    assert error_mm(mesh, u, lambda R: r(R) - R) < 1e-4 * inner


@pytest.mark.parametrize("kind", BODIES)
def test_displacement_converges_with_the_third_order(kind):
    """Halving the element size divides the error by eight; the order is within 10 %."""
    constants = CorneaConstants((0.05,), (8.0,))
    pressure = 0.04
    r = finite_radius(INNER, OUTER, pressure, constants, kind == "axisymmetric")
    errors = []
    for cells in (2, 4, 8, 16):
        mesh = quarter_ring(2 * cells, cells)
        u = inflated(mesh, kind, pressure, constants)
        errors.append(error_mm(mesh, u, lambda R: r(R) - R))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-2:] == pytest.approx(3.0, abs=0.3)
