"""Blocks between plates, checked against exact solutions and another solver."""

import felupe
import numpy as np
import pytest
from scipy.optimize import fsolve, minimize
from scipy.sparse import bmat, bsr_matrix
from scipy.sparse.linalg import spsolve

from palpate.workers.blind.solver.plate_contact import PENALTY_N_PER_MM3
from palpate.workers.blind.solver.plate_equilibrium import (
    DENSITY_T_PER_MM3,
    GRAVITY_MM_PER_S2,
    Newton,
    State,
    interpolation_of,
)
from palpate.workers.blind.solver.tissue_energy import (
    Cells,
    cells_of,
    sheet_energy,
    sheet_of,
    tissue_energy,
)
from palpate.workers.blind.solver.two_level_solver import (
    TwoLevel,
    conjugate_gradients,
    factorised_coarse_tangent,
)
from tests.workers.blind.pressed_blocks import block, materials, pressed

SIDES = np.array([24.0, 20.0, 16.0])


def at_rest(system, force_n, tolerance=1e-7):
    start = State(np.zeros_like(system.topology.mesh.nodes), 0.05)
    return Newton(system).equilibrium(start, force_n, tolerance)[0]


def density(stretches, mu, kappa, eta, fung):
    """Return the energy density of a block stretched along x, y and z, with fibres along z."""
    J = np.prod(stretches)
    shear = J ** (-2 / 3) * np.sum(np.square(stretches)) - 3
    pull = max(J ** (-2 / 3) * stretches[2] ** 2 - 1, 0.0)
    fungs = np.expm1(fung * shear) / fung if fung else shear
    return 0.5 * (mu * fungs + kappa * (J - 1) ** 2 + eta * pull**2)


@pytest.mark.parametrize(
    "constants", [(0.01, 0.5, 0.0, 0.0), (0.004, 0.2, 0.08, 0.0), (0.004, 0.2, 0.02, 6.0)]
)
def test_uniform_block_matches_the_exact_solution(constants):
    # With free sides and no friction, the stretches are uniform and the sides stress-free.
    mu, kappa, eta, fung = constants
    mesh = block((3, 2, 2), SIDES)
    system = pressed(mesh, materials(mesh, mu, kappa, eta, fung), SIDES[1] / 2)
    state = at_rest(system, 1.2)
    pressure = 1.2 / (SIDES[0] * SIDES[2])

    def load(y):
        free = minimize(
            lambda s: density([s[0], y, s[1]], *constants),
            [y**-0.5] * 2,
            method="Nelder-Mead",
            options={"xatol": 1e-10, "fatol": 1e-16},
        ).x
        ends = [density([free[0], y + s, free[1]], *constants) for s in (1e-5, -1e-5)]
        return free, (ends[0] - ends[1]) / 2e-5

    # The penetration at each plate is the nominal pressure divided by the penalty.
    y = fsolve(lambda s: (load(s[0])[1] + pressure) * 1e3, 0.85)[0]
    free, _ = load(y)
    dug = 2 * pressure / PENALTY_N_PER_MM3
    assert y < 0.95
    assert state.travel == pytest.approx((1 - y) * SIDES[1] + dug, abs=2e-4)
    spread = np.ptp(state.u, axis=0)
    assert spread[0] == pytest.approx((free[0] - 1) * SIDES[0], abs=2e-4)
    assert spread[2] == pytest.approx((free[1] - 1) * SIDES[2], abs=2e-4)
    # Straight lines stay straight, so mid-edge nodes are at the mean of their ends.
    ends = mesh.ends[mesh.corners :]
    middles = state.u[ends].mean(axis=1)
    assert np.abs(state.u[mesh.corners :] - middles).max() < 1e-4


def test_swollen_block_is_larger_and_stress_free():
    mesh = block((2, 2, 2), SIDES)
    grown = materials(mesh, growth=1.02)
    u = 0.02 * mesh.nodes
    assert tissue_energy(cells_of(mesh), grown, u) == pytest.approx(0, abs=1e-12)
    assert tissue_energy(cells_of(mesh), grown, 0 * u) > 1e-2


def test_sheet_has_its_tensile_stiffness():
    # E t of a thin strip: under a small uniaxial strain the energy is E t e^2 / 2 per area.
    mesh = block((2, 1, 1), SIDES)
    strain = 1e-4
    u = mesh.nodes * [strain, -strain / 2, -strain / 2]
    faces = 2 * (SIDES[0] * SIDES[1] + SIDES[0] * SIDES[2]) - SIDES[0] * SIDES[1]
    ends = 2 * SIDES[1] * SIDES[2]
    # The ends are strained by -e/2 along both axes: 2 E t / 3 (a^2 + a b + b^2) with a = b = -e/2.
    wanted = 0.5 * 3.0 * strain**2 * (faces + ends)
    assert sheet_energy(sheet_of(mesh, 3.0), u) == pytest.approx(wanted, rel=1e-3)


def test_gradients_integrate_to_the_deformed_volume():
    mesh = block((2, 2, 1), SIDES)
    cells: Cells = cells_of(mesh)
    assert cells.volumes.sum() == pytest.approx(SIDES.prod())
    assert cells.volumes.min() > 0
    assert len(mesh.wall) == 8
    assert len(mesh.skin) + len(mesh.wall) == 2 * (2 * 4 + 2 * 2 * 2 + 0)


def layered(mesh):
    """Return materials that are stiffer above z = 8, an element boundary."""
    of = materials(mesh, 0.004, 0.2)
    high = mesh.nodes[mesh.cells[:, :4], 2].mean(axis=1) > 8
    of.mu[high] *= 4
    of.kappa[high] *= 4
    return of


def felupe_force(closed, counts):
    """Return the force on the layered block when its y faces approach, from quadratic hexahedra."""
    mesh = (
        felupe.Cube(a=(-12, -10, 0), b=(12, 10, 16), n=tuple(c + 1 for c in counts))
        .add_midpoints_edges()
        .add_midpoints_faces()
        .add_midpoints_volumes()
    )
    mesh.update(cells=mesh.cells, cell_type="hexahedron27")
    region = felupe.RegionTriQuadraticHexahedron(mesh)
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    z = mesh.points[mesh.cells[:, :8], 2].mean(axis=1)
    stiff = np.where(z > 8, 4.0, 1.0)
    umat = felupe.NeoHooke(mu=0.004 * stiff, bulk=0.2 * stiff)
    solid = felupe.SolidBody(umat, field)
    middle = {"fx": 0.0, "fy": 0.0, "fz": 0.0}
    bounds = {
        "z": felupe.Boundary(field[0], fz=0, skip=(1, 1, 0)),
        "x": felupe.Boundary(field[0], **middle, mode="and", skip=(0, 1, 1)),
        "low": felupe.Boundary(field[0], fy=-10, skip=(1, 0, 1), value=closed / 2),
        "high": felupe.Boundary(field[0], fy=10, skip=(1, 0, 1), value=-closed / 2),
    }
    dof0, dof1 = felupe.dof.partition(field, bounds)
    ext0 = felupe.dof.apply(field, bounds, dof0)
    felupe.newtonraphson(
        items=[solid], dof0=dof0, dof1=dof1, ext0=ext0, kwargs={}, verbose=False, tol=1e-8
    )
    force = solid.assemble.vector(field).toarray().reshape(-1, 3)
    high = mesh.points[:, 1] == 10
    return -force[high, 1].sum(), mesh.points, field[0].values


def test_layered_block_agrees_with_felupe_hexahedra():
    mesh = block((6, 5, 6), SIDES)
    system = pressed(mesh, layered(mesh), SIDES[1] / 2)
    state = at_rest(system, 2.0, 1e-6)
    dug = 2 * 2.0 / (SIDES[0] * SIDES[2]) / PENALTY_N_PER_MM3
    force, points, moved = felupe_force(state.travel - dug, (4, 4, 4))
    assert force == pytest.approx(2.0, rel=0.01)
    # The free upper end bulges by the same amount.
    ours = state.u[np.abs(mesh.nodes - [0, 0, 16]).sum(axis=1).argmin(), 2]
    theirs = moved[np.abs(points - [0, 0, 16]).sum(axis=1).argmin(), 2]
    assert ours == pytest.approx(theirs, abs=0.02 * abs(theirs))


def test_friction_is_at_most_the_coefficient_times_the_force():
    # Two plates carry at most 2 mu F of the weight; springs on the wall carry the rest.
    mesh = block((3, 2, 2), SIDES)
    force, friction, spring = 1.0, 0.25, 0.002
    weight = 3 * 2 * friction * force
    gravity = weight / (DENSITY_T_PER_MM3 * GRAVITY_MM_PER_S2 * SIDES.prod())
    of = materials(mesh, 2.0, 40.0)
    system = pressed(mesh, of, SIDES[1] / 2, spring, friction, (gravity, 0, 0))
    newton = Newton(system)
    state = State(np.zeros_like(mesh.nodes), 0.05)
    for _ in range(2):
        state, _ = newton.equilibrium(state, force, 1e-5)
        system.end_step(state)
    held = -float((system.spring_forces(state.u) - system.weight)[:, 0].sum())
    assert held == pytest.approx(2 * friction * force, rel=0.01)


def test_conjugate_gradients_agree_with_a_factorisation():
    mesh = block((4, 3, 3), SIDES)
    system = pressed(mesh, layered(mesh), SIDES[1] / 2, 1e-5)
    state = at_rest(system, 1.0, 1e-4)
    force, tangent = system.linearised(state, 1.4)
    top = system.topology
    starts, columns = top.pattern
    rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    interpolation = interpolation_of(system)
    inverses = np.linalg.inv(tangent.blocks[rows == columns])
    factor = factorised_coarse_tangent(
        top.coarsening, tangent.blocks, tangent.border, tangent.corner, interpolation
    )
    cycle = TwoLevel(top.pattern, tangent.blocks, tangent.border, inverses, interpolation, factor)
    solution = conjugate_gradients(cycle, tangent.corner, force.u, force.travel, 1e-9)
    inner = bsr_matrix((tangent.blocks, columns, starts))
    edge = tangent.border.reshape(-1, 1)
    whole = bmat([[inner, edge], [edge.T, [[tangent.corner]]]], format="csc")
    exact = spsolve(whole, -np.append(force.u.ravel(), force.travel))
    assert np.abs(solution.u.ravel() - exact[:-1]).max() < 1e-5 * np.abs(exact[:-1]).max()
    assert solution.travel == pytest.approx(exact[-1], rel=1e-6)
    assert solution.iterations < 60
