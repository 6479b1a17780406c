"""Forces and tangents of tissue, skin, springs and plates, checked by central differences."""

import numpy as np
import pytest

from palpate.workers.blind.solver.plate_equilibrium import State, System, topology_of
from palpate.workers.blind.solver.tissue_energy import ElementMaterials, sheet_of
from tests.workers.blind.pressed_blocks import block, materials, plates, wall

STEP = 1e-5
SYSTEMS = ["tissue", "weight", "plates", "bent", "short", "friction", "skin", "tether"]
FORCE_N = 0.3


@pytest.fixture(scope="module")
def mesh():
    return block((2, 1, 1), (7.0, 5.0, 4.0))


def random_state(mesh, seed):
    rng = np.random.default_rng(seed)
    return State(0.12 * rng.standard_normal(mesh.nodes.shape), 0.4)


def random_matter(mesh):
    rng = np.random.default_rng(3)
    shape = (len(mesh.cells), 4)
    fibre = rng.standard_normal((*shape, 3))
    fibre /= np.linalg.norm(fibre, axis=2)[..., None]
    ranges = ((0.005, 0.02), (0.1, 0.5), (0.05, 0.1), (0.0, 4.0), (0.95, 1.05))
    return ElementMaterials(*(rng.uniform(*r, shape) for r in ranges), fibre)


def rubbed(system, state):
    """Set friction that sticks at some points and slides at others."""
    system.renew_friction(state)
    for friction_state in system.friction_states:
        friction_state.origin[:] = 0.05 * np.random.default_rng(4).standard_normal(
            friction_state.origin.shape
        )
    return system


def systems(mesh):
    top = topology_of(mesh)
    smooth = np.zeros(top.skin.areas.shape)
    of, still = materials(mesh), np.zeros(3)
    flat, bent = plates(2.5), plates(2.6, slopes=(0.1, -0.07), sag=4.0)
    # Most points of the skin are where the plates start to press, or fully press.
    short = plates(2.6, slopes=(0.1, -0.07), sag=4.0, edge=-0.5)
    springs = np.random.default_rng(6).uniform(0, 1e-2, smooth.shape)
    return {
        "tissue": System(top, random_matter(mesh), wall(top, 1e-3), plates(50.0), smooth, still),
        "weight": System(top, of, wall(top, 1e-3), plates(50.0), smooth, np.array([1e3, 2e3, 0])),
        "plates": System(top, of, wall(top, 1e-3), flat, smooth, still),
        "bent": System(top, of, wall(top, 1e-3), bent, smooth, still),
        "short": System(top, of, wall(top, 1e-3), short, smooth + 0.3, still),
        "friction": System(top, of, wall(top, 1e-3), bent, smooth + 0.3, still),
        "skin": System(top, of, wall(top, 1e-3), plates(50.0), smooth, still, sheet_of(mesh, 0.5)),
        "tether": System(top, of, wall(top, 0.0), plates(50.0), smooth, still, tether=springs),
    }


def nudged(system, state, seed):
    """Return a random direction in all free components, including the travel."""
    rng = np.random.default_rng(seed)
    return State(rng.standard_normal(state.u.shape) * system.free, rng.standard_normal())


@pytest.mark.parametrize("name", SYSTEMS)
def test_force_is_the_derivative_of_the_energy(mesh, name):
    state = random_state(mesh, 0)
    system = rubbed(systems(mesh)[name], state)
    force, _ = system.linearised(state, FORCE_N)
    for seed in range(5):
        way = nudged(system, state, seed)
        ahead, behind = (system.energy(state.plus(way, s), FORCE_N) for s in (STEP, -STEP))
        slope = (force.u * way.u).sum() + force.travel * way.travel
        assert slope == pytest.approx((ahead - behind) / (2 * STEP), rel=2e-6)


@pytest.mark.parametrize("name", SYSTEMS)
def test_tangent_is_the_derivative_of_the_force(mesh, name):
    state = random_state(mesh, 0)
    system = rubbed(systems(mesh)[name], state)
    _, tangent = system.linearised(state, FORCE_N)
    starts, columns = system.topology.pattern
    rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    for seed in range(3):
        way = nudged(system, state, seed)
        slope = way.travel * tangent.border
        np.add.at(slope, rows, np.einsum("bij,bj->bi", tangent.blocks, way.u[columns]))
        ahead, behind = (system.linearised(state.plus(way, s), FORCE_N)[0] for s in (1e-6, -1e-6))
        wanted = (ahead.u - behind.u) / 2e-6
        assert np.abs(slope - wanted).max() < 1e-4 * np.abs(wanted).max()
        on_travel = (tangent.border * way.u).sum() + tangent.corner * way.travel
        assert on_travel == pytest.approx((ahead.travel - behind.travel) / 2e-6, rel=1e-4, abs=1e-8)
