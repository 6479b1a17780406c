"""Manufactured solutions: orders of convergence under mesh refinement.

A smooth finite motion of a cube is chosen and held on its boundary, and the body force
b = -Div P that keeps it in equilibrium is computed by complex step from a separate
implementation of the law. Linear elements have order 2 in displacement and order 1 in
stress (Brenner & Scott 2008, section 5.4).
"""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, FibreField
from palpate.workers.mechanics.fem.discretisation import State
from palpate.workers.mechanics.fem.element_energy import deformation_gradients
from palpate.workers.mechanics.fem.energy_minimisation import minimise
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.multigrid import LinearSolver, solver_factory
from tests.workers.mechanics.fem.blocks import OPEN, holding, loose_level
from tests.workers.mechanics.fem.solids import body, box

SIDE = 10.0
CELLS = (4, 8, 16)
FIBRE = np.array([1.0, 2.0, -1.0]) / np.sqrt(6)
SHEARS = (0.8, -0.6, 0.7)

# Four points of a tetrahedron, exact for quadratic functions (Keast 1986).
_FAR, _NEAR = 0.5854101966249685, 0.1381966011250105
POINTS = np.full((4, 4), _NEAR) + (_FAR - _NEAR) * np.eye(4)


def motion(X: np.ndarray, c: Constants) -> tuple[np.ndarray, np.ndarray]:
    """Return positions x, (..., 3), and F, (..., 3, 3), of points X, real or complex.

    A swelling by mu / kappa, so that the pressure is of the order of mu whatever nu is,
    and three finite shears on top, which keep the volume.
    """
    a = np.pi / SIDE
    swelling = c.mu_mpa / c.kappa_mpa / a
    x = X + swelling * np.sin(a * X)
    F = (1 + swelling * a * np.cos(a * X))[..., None] * np.eye(3)
    for i, size in enumerate(SHEARS):
        j, k = (i + 1) % 3, (i + 2) % 3
        slope = np.zeros_like(x)
        slope[..., j] = size * a * np.cos(a * x[..., j]) * np.cos(a * x[..., k])
        slope[..., k] = -size * a * np.sin(a * x[..., j]) * np.sin(a * x[..., k])
        moved = size * np.sin(a * x[..., j]) * np.cos(a * x[..., k])
        F = F + np.eye(3)[i][:, None] * (slope[..., None, :] @ F)
        x = x + np.eye(3)[i] * moved[..., None]
    return x, F


def stress(F: np.ndarray, c: Constants) -> np.ndarray:
    """Return P of neo-Hooke, the volume term kappa/2 (J-1)^2 and fibres eta/2 (I4-1)^2."""
    J = np.linalg.det(F)[..., None, None]
    H = np.swapaxes(np.linalg.inv(F), -1, -2)
    I1 = (F * F).sum(axis=(-1, -2))[..., None, None]
    w = F @ FIBRE
    pull = 2 * c.fibre_mpa * ((w * w).sum(axis=-1) - 1)
    P = c.mu_mpa * J ** (-2 / 3) * (F - I1 / 3 * H) + c.kappa_mpa * (J - 1) * J * H
    return P + pull[..., None, None] * w[..., :, None] * FIBRE


def body_force(X: FloatArray, c: Constants) -> FloatArray:
    """Return -Div P at points (..., 3), in N/mm^3."""
    h = 1e-30
    force = np.zeros(X.shape)
    for j in range(3):
        ahead = X + 1j * h * np.eye(3)[j]
        force -= stress(motion(ahead, c)[1], c)[..., j].imag / h
    return force


def quadrature(level: Level) -> FloatArray:
    """Return the quadrature points, shape (m, 4, 3)."""
    m = level.model
    return np.einsum("qa,eai->eqi", POINTS, m.nodes[m.elements.tets])


def loaded(level: Level, c: Constants) -> Level:
    """Return the level with consistent nodal body forces and the boundary held."""
    m = level.model
    share = np.einsum(
        "e,eqi,qa->eai", m.elements.volumes / 4, body_force(quadrature(level), c), POINTS
    )
    load = np.zeros_like(m.nodes)
    np.add.at(load, m.elements.tets, share)
    boundary = ((m.nodes < 1e-9) | (m.nodes > SIDE - 1e-9)).any(axis=1)
    return holding(replace(level, dead_load=load), boundary)


def errors(level: Level, x: FloatArray, c: Constants) -> tuple[float, float]:
    """Return the L2 errors of displacement and P, with four points per element."""
    m = level.model
    at, weight = quadrature(level), np.repeat(m.elements.volumes / 4, 4)
    u = np.einsum("qa,eai->eqi", POINTS, (x - m.nodes)[m.elements.tets])
    exact, exact_F = motion(at, c)
    wrong = (at + u - exact).reshape(-1, 3)
    F = deformation_gradients(x, m.elements)
    P = stress(F, c)
    if not level.constants.material.plain:
        # The pressure of an element is the mean over its nodes.
        volumes = level.energy(State(x, 0.0), OPEN).nodal_volumes
        p = (level.nodal_bulk_mpa * (volumes / m.nodal_volumes - 1))[m.elements.tets].mean(axis=1)
        J = np.linalg.det(F)
        H = np.swapaxes(np.linalg.inv(F), 1, 2)
        P += ((p - c.kappa_mpa * (J - 1)) * J)[:, None, None] * H
    off = (P[:, None] - stress(exact_F, c)).reshape(-1, 9)
    return tuple(float(np.sqrt(weight @ (e * e).sum(axis=1))) for e in (wrong, off))  # type: ignore[return-value]


def test_deformation_gradient_is_the_derivative_of_the_motion():
    X = np.random.default_rng(0).uniform(0, SIDE, (20, 3))
    c = Constants(0.01, 0.3)
    F = motion(X, c)[1]
    assert np.abs(F - np.eye(3)).max() > 0.3
    for j in range(3):
        slope = motion(X + 1e-30j * np.eye(3)[j], c)[0].imag / 1e-30
        np.testing.assert_allclose(F[..., j], slope, atol=1e-14)


def study(c: Constants, *, plain: bool) -> FloatArray:
    """Return the errors of displacement and stress on each mesh, shape (3, 2)."""
    model = body([(n, n, n) for n in CELLS], box(SIDE, SIDE, SIDE), jitter=0.15)
    solvers: list[LinearSolver] = []
    found = []
    for each in model:
        fibres = FibreField(tuple(FIBRE))
        level = loose_level(each, c, plain_elements=plain, fibres=fibres, literal_fibre=True)
        level = loaded(level, c)
        result = minimise(
            level, State(motion(each.nodes, c)[0], 0.0), OPEN, solver_factory(solvers), 1e-5
        )
        assert result.reason == ""
        solvers.append(result.linear)
        found.append(errors(level, result.state.x, c))
    return np.array(found)


@pytest.mark.parametrize(
    ("nu", "plain"), [(0.3, False), (0.3, True), (0.49, False)], ids=["0.3", "0.3 plain", "0.49"]
)
def test_displacement_and_stress_converge_at_the_expected_orders(nu, plain):
    found = study(Constants(0.01, nu, fibre_mpa=0.003), plain=plain)
    displacement, stresses = np.log2(found[-2] / found[-1])
    assert displacement == pytest.approx(2, abs=0.15)
    assert stresses == pytest.approx(1, abs=0.15)


def test_plain_elements_lock_but_averaged_elements_do_not():
    """At nu = 0.499, on coarse meshes."""
    c = Constants(0.01, 0.499, fibre_mpa=0.003)
    averaged, plain = (study(c, plain=p) for p in (False, True))
    assert plain[-1, 0] > 2 * averaged[-1, 0]
    assert plain[-1, 1] > 10 * averaged[-1, 1]
    assert np.log2(plain[-2, 0] / plain[-1, 0]) < 1.5
    assert np.log2(averaged[-2, 0] / averaged[-1, 0]) > 1.8
