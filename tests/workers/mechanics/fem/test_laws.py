"""All laws in the solver, against homogeneous deformations."""

import numpy as np
import pytest
from scipy.optimize import brentq

from palpate.workers.mechanics.fem.boundary_value_problem import Constants
from palpate.workers.mechanics.fem.discretisation import State
from palpate.workers.mechanics.fem.energy_minimisation import minimise
from palpate.workers.mechanics.fem.multigrid import solver_factory
from palpate.workers.mechanics.materials.law_plugins import law_named
from tests.workers.mechanics.fem.blocks import OPEN, cube, holding, loose_level, model_of

SHAPES = {
    "neo-hookean": {},
    "mooney-rivlin": {"mooney_rivlin_share2": 0.3},
    "yeoh": {"yeoh_c2": 0.8, "yeoh_c3": 0.4},
    "fung": {"fung_b": 3.0},
    "ogden": {"ogden_alpha": 9.0},
    "ogden-2": {"ogden_2_alpha1": 3.0, "ogden_2_alpha2": -8.0, "ogden_2_share2": 0.4},
}
SIDE, STRETCH, SHEAR = 10.0, 0.75, 0.3


@pytest.fixture(scope="module")
def model():
    return model_of(cube(2, SIDE, jitter=0.2)).finest


def constants_of(name: str) -> Constants:
    """Return constants with an explicit law, even for the neo-Hookean one."""
    mu = Constants(0.01, 0.49).mu_mpa
    return Constants(0.01, 0.49, law=law_named(name).law(mu, SHAPES[name]))


def nominal(c: Constants, F: np.ndarray) -> np.ndarray:
    """Return P = dW/dF + kappa (J - 1) J F^-T."""
    J = np.linalg.det(F)
    return c.law.stress(F) + c.kappa_mpa * (J - 1) * J * np.linalg.inv(F).T


@pytest.mark.parametrize("name", SHAPES)
def test_uniaxial_compression_is_exact(model, name):
    """The stretch of the free sides gives P_x = P_z = 0."""
    c = constants_of(name)

    def side_stress(side: float) -> float:
        return float(nominal(c, np.diag([side, STRETCH, side]))[0, 0])

    side = brentq(side_stress, 1.0, 1.4, xtol=1e-13)
    X = model.nodes
    held, top = X < 1e-9, X[:, 1] > SIDE - 1e-9
    held[top, 1] = True
    level = holding(loose_level(model, c), held)
    start = State(X * [1.1, STRETCH, 1.1], 0.0)
    result = minimise(level, start, OPEN, solver_factory(()), 1e-8)
    assert result.reason == ""
    np.testing.assert_allclose(result.state.x, X * [side, STRETCH, side], atol=1e-6)
    force = level.force(result.state, level.energy(result.state, OPEN), OPEN)
    stress = nominal(c, np.diag([side, STRETCH, side]))[1, 1]
    assert force[top, 1].sum() == pytest.approx(SIDE**2 * stress, rel=1e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_simple_shear_is_exact(model, name):
    """The interior follows a sheared boundary, and the upper face carries P e_y."""
    c, X = constants_of(name), model.nodes
    F = np.eye(3)
    F[0, 1] = SHEAR
    inner = ((X > 1e-9) & (X < SIDE - 1e-9)).all(axis=1)
    level = holding(loose_level(model, c), ~inner)
    moved = np.random.default_rng(1).uniform(-0.3, 0.3, X.shape) * inner[:, None]
    result = minimise(level, State(X @ F.T + moved, 0.0), OPEN, solver_factory(()), 1e-8)
    assert result.reason == ""
    np.testing.assert_allclose(result.state.x, X @ F.T, atol=1e-6)
    at = State(X @ F.T, 0.0)
    force = level.force(at, level.energy(at, OPEN), OPEN)
    virial = force.T @ X / SIDE**3
    np.testing.assert_allclose(virial, nominal(c, F), atol=1e-8)


def test_neutral_shape_equals_the_compiled_neo_hookean_matrix(model):
    """At neutral shape constants every law gives the same forces as a tissue without a law."""
    X = model.nodes
    state = State(X + np.random.default_rng(2).uniform(-0.4, 0.4, X.shape), 0.0)
    own = Constants(0.01, 0.49)
    level = loose_level(model, own)
    expected = level.force(state, level.energy(state, OPEN), OPEN)
    for name in SHAPES:
        law = law_named(name).law(own.mu_mpa, {})
        level = loose_level(model, Constants(0.01, 0.49, law=law))
        force = level.force(state, level.energy(state, OPEN), OPEN)
        np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-12, err_msg=name)
