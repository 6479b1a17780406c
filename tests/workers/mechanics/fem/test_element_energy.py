"""Force and tangent are the derivatives of the energy, for every part of it."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem import element_energy, membrane, sparse_products
from palpate.workers.mechanics.fem.boundary_value_problem import (
    Constants,
    FibreField,
    Frame,
    Gradient,
    Inclusion,
    Membrane,
    Problem,
)
from palpate.workers.mechanics.fem.discretisation import History, Stage, State
from palpate.workers.mechanics.fem.loads_and_regions import Device, ForceControl, Plate, Wall
from palpate.workers.mechanics.fem.mesh_level import Level, Tangent
from palpate.workers.mechanics.fem.multigrid import dense_matrix
from palpate.workers.mechanics.fem.plate_surface import Gap
from palpate.workers.mechanics.materials.polynomial_laws import MooneyRivlin
from tests.workers.mechanics.fem.blocks import OPEN, cube, loose_level, model_of

FAT = Constants(0.01, 0.49, fibre_mpa=0.02)
FRAME = Frame((5, 5, 5), (5, 5, 5))
TILTED = Device(
    pivot_mm=(5, 5, 5),
    upper=Plate(tilt_deg=(4.0, -3.0), bow_per_mm=(0.01, -0.02)),
    lower=Plate(tilt_deg=(-2.0, 1.0)),
    lower_share=0.3,
)
KINDS = {
    "nodal volume": {},
    "plain": {"plain_elements": True},
    "literal fibre": {"literal_fibre": True},
    "tilted fibre": {"fibres": FibreField((1.0, 2.0, -0.5))},
    "fanned fibre": {"fibres": FibreField(turn_deg=(5, 10), fan_deg=(20, 30), frame=FRAME)},
    "isochoric fibre": {"isochoric_fibre": True, "literal_fibre": True},
    "two families": {"constants": {Tissue.FAT: Constants(0.01, 0.49, 0.02, 0.03)}},
    "stiffening": {"constants": {Tissue.FAT: Constants(0.01, 0.49, 0.02, stiffening=2.0)}},
    "another law": {
        "constants": {Tissue.FAT: Constants(0.01, 0.49, law=MooneyRivlin(0.002, 0.001))}
    },
    "variations": {
        "variations": (Gradient((0.3, -0.2, 0.5), FRAME), Inclusion(1.5, (4.0, 5.0, 6.0), 3.0))
    },
    "foundation": {"wall": Wall((False, False, False), (1e-3, 2e-3, 3e-3))},
    "gravity": {"gravity_g": (0.3, -1.0, 0.5)},
    "skin": {"membrane": Membrane(0.5, 1.5)},
    "skin without wrinkles": {"membrane": Membrane(0.5, 1.5, wrinkles=False)},
    "plates": {"load": ForceControl(0.3, 0.3, 9.5)},
    "tilted plates": {"load": ForceControl(0.3, 0.3, 9.5, TILTED)},
    "friction": {"load": ForceControl(0.3, 0.3, 9.5, Device(pivot_mm=(5, 5, 5), friction=0.4))},
    "tilted friction": {
        "load": ForceControl(
            0.3, 0.3, 9.5, Device(upper=Plate((6.0, 3.0)), lower_share=0.4, friction=0.4)
        )
    },
}


@pytest.fixture(scope="module")
def model():
    return model_of(cube(2, jitter=0.2)).finest


def level_with(model, kind: str) -> tuple[Level, Stage, History]:
    options = {"constants": {Tissue.FAT: FAT}, "load": ForceControl(0.3, -1e6, 1e6)} | KINDS[kind]
    problem = Problem(**options)
    load = problem.load
    stage = Stage(Gap(load.lower_mm, load.upper_mm), load.force_n, 0.7, load.device)
    level = Level.build(model, problem)
    level = replace(level, free=np.ones_like(level.free))
    begun = level.begin_step(State(model.nodes, 0.0), stage)
    slipped = level.update_history(begun.moved_to(model.nodes * [1, 1.02, 1], 0.3), stage)
    return level, stage, slipped.history


def somewhere(model, seed: int, history: History) -> State:
    rng = np.random.default_rng(seed)
    return State(model.nodes + rng.uniform(-0.5, 0.5, model.nodes.shape), 0.2, history)


def moved(state: State, h: float, direction: np.ndarray, travel: float = 0.0) -> State:
    return state.moved_to(state.x + h * direction, state.travel_mm + h * travel)


def times(level: Level, tangent: Tangent, v: np.ndarray) -> np.ndarray:
    """Return the tangent times `v`, (n, 3), without the travel of the plates."""
    g = level.model.graph
    matrix = g.start.view(np.uint32), g.neighbour.view(np.uint32), tangent.rows
    x, y = np.zeros((2, len(v), 4))
    x[:, :3] = v
    sparse_products.set_pressure(*matrix, x)
    sparse_products.multiply(*matrix, x, y)
    return y[:, :3]


@pytest.mark.parametrize("kind", KINDS)
def test_force_is_the_derivative_of_the_potential(model, kind):
    level, stage, history = level_with(model, kind)
    state, h = somewhere(model, 1, history), 1e-5
    at = level.energy(state, stage)
    force, _ = level.linearise(state, at, stage)
    direction = np.random.default_rng(3).standard_normal(state.x.shape)
    travel = 0.7
    ahead, behind = (
        level.energy(moved(state, sign * h, direction, travel), stage).potential for sign in (1, -1)
    )
    expected = np.vdot(force, direction) + (at.contact.travel_force - stage.force_n) * travel
    assert expected == pytest.approx((ahead - behind) / (2 * h), rel=1e-7)
    np.testing.assert_allclose(level.force(state, at, stage), force, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_tangent_is_the_derivative_of_the_force(model, kind):
    level, stage, history = level_with(model, kind)
    state, h = somewhere(model, 2, history), 1e-6
    direction = np.random.default_rng(4).standard_normal(state.x.shape)
    travel = 0.7

    def forces(s: State) -> tuple[np.ndarray, float]:
        at = level.energy(s, stage)
        return level.linearise(s, at, stage)[0], at.contact.travel_force

    ahead, behind = (forces(moved(state, sign * h, direction, travel)) for sign in (1, -1))
    _, t = level.linearise(state, level.energy(state, stage), stage)
    product = times(level, t, direction)
    product[t.contact_index] += travel * t.coupling
    expected = (ahead[0] - behind[0]) / (2 * h)
    # The blocks are stored in single precision.
    assert np.abs(product - expected).max() < 3e-6 * np.abs(expected).max()
    row = np.vdot(t.coupling, direction[t.contact_index]) + t.plate_stiffness * travel
    assert row == pytest.approx((ahead[1] - behind[1]) / (2 * h), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("height", [0.45, 0.5, 0.55])
@pytest.mark.parametrize("kind", ["nodal volume", "plain", "another law", "two families", "skin"])
def test_barrier_force_and_tangent_are_derivatives(model, kind, height):
    """Elements of a flattened block are on both sides of the volume where the barrier begins."""
    level, stage, history = level_with(model, kind)
    level = level.with_barrier()
    rng = np.random.default_rng(5)
    x = model.nodes * [1, 1, height] + rng.uniform(-0.3, 0.3, model.nodes.shape)
    state, h, direction = State(x, 0.2, history), 1e-5, rng.standard_normal(x.shape)
    ratios = np.linalg.det(element_energy.deformation_gradients(x, model.elements))
    assert ratios.min() < 0.5 < ratios.max()

    def at(length: float):
        there = moved(state, length * h, direction)
        energy = level.energy(there, stage)
        return energy, *level.linearise(there, energy, stage)

    (ahead, force_ahead, _), (behind, force_behind, _) = at(1.0), at(-1.0)
    _, force, tangent = at(0.0)
    slope = (ahead.potential - behind.potential) / (2 * h)
    assert np.vdot(force, direction) == pytest.approx(slope, rel=1e-7)
    expected = (force_ahead - force_behind) / (2 * h)
    miss = times(level, tangent, direction) - expected
    assert np.abs(miss).max() < 3e-6 * np.abs(expected).max()


@pytest.mark.parametrize("kind", ["nodal volume", "another law"])
def test_barrier_energy_is_the_formula(model, kind):
    """W = 100 mu (1 - 2 J)^3 in a block of 0.4 of its volume."""
    level, stage, history = level_with(model, kind)
    constants = level.problem.constants[Tissue.FAT]
    mu = constants.law.shear_modulus_mpa if constants.law else constants.mu_mpa
    state = State(model.nodes * 0.4 ** (1 / 3), 0.2, history)
    guarded = level.with_barrier()
    stored = guarded.energy(state, stage).elastic - level.energy(state, stage).elastic
    assert stored == pytest.approx(100 * mu * 0.2**3 * model.elements.volumes.sum(), rel=1e-9)


def test_barrier_of_shrunken_tissue_begins_below_its_own_volume(model):
    for growth, begins in ((0.6, 0.3), (1.6, 0.5)):
        grown = loose_level(model, replace(FAT, growth=growth))
        assert grown.with_barrier().barrier.j == pytest.approx(begins)


@pytest.mark.parametrize(
    "kind", ["nodal volume", "stiffening", "isochoric fibre", "two families", "tilted fibre"]
)
def test_positive_tangent_has_no_negative_eigenvalue(model, kind):
    level, stage, history = level_with(model, kind)
    level = level.with_barrier()
    x = model.nodes * [1.5, 1.3, 0.4]
    x += np.random.default_rng(6).uniform(-0.5, 0.5, x.shape)
    state, g = State(x, 0.0, history), model.graph
    at = level.energy(state, stage)

    def smallest(**kind: bool) -> float:
        _, tangent = level.linearise(state, at, stage, **kind)
        A = dense_matrix(g.start, g.neighbour, tangent.rows, level.free)
        values = np.linalg.eigvalsh(A)
        return float(values[0] / values[-1])

    assert smallest(convex=True, positive=True) > -1e-6
    assert smallest() < -1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_dense_tangent_equals_the_sparse_one(model, kind):
    level, stage, history = level_with(model, kind)
    state = State(model.nodes * [1.1, 0.8, 1.05], 0.2, history)
    _, t = level.linearise(state, level.energy(state, stage), stage)
    g = model.graph
    A = dense_matrix(g.start, g.neighbour, t.rows, level.free)
    np.testing.assert_allclose(A, A.T, atol=1e-6 * np.abs(A).max())
    v = np.random.default_rng(3).standard_normal(state.x.shape)
    product = times(level, t, v)
    np.testing.assert_allclose(A @ v.ravel(), product.ravel(), atol=1e-9 * np.abs(product).max())


def test_rotated_body_has_no_energy(model):
    level = loose_level(model, FAT)
    c, s = np.cos(0.7), np.sin(0.7)
    turned = model.nodes @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) + [3, -2, 1]
    state = State(turned, 0.0)
    at = level.energy(state, OPEN)
    assert at.elastic == pytest.approx(0, abs=1e-12)
    assert np.abs(level.force(state, at, OPEN)).max() < 1e-12


def test_inverted_element_has_finite_energy(model):
    level = loose_level(model, FAT)
    x = model.nodes.copy()
    x[13] += 12.0
    assert np.isfinite(level.energy(State(x, 0.0), OPEN).potential)


def test_stretched_sheet_has_the_closed_form_energy():
    """W = mu t A / 2 (l1^2 + l2^2 + 1 / (l1 l2)^2 - 3) for an incompressible sheet."""
    nodes = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]], float)
    sheet = membrane.sheet_of(nodes, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    l1, l2, stiffness = 1.3, 0.9, 0.25
    energy = membrane.sheet_energy(
        nodes * [l1, l2, 1], sheet.triangles, sheet.metric, sheet.area, stiffness, False
    )
    exact = stiffness * 6 / 2 * (l1**2 + l2**2 + 1 / (l1 * l2) ** 2 - 3)
    assert energy == pytest.approx(exact, rel=1e-12)
