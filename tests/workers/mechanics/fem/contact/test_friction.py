"""Coulomb friction between plates and skin."""

import numpy as np
import pytest

from palpate.storage.values import FloatArray, Tissue
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium, solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.loads_and_regions import (
    EVERYWHERE,
    Box,
    Device,
    DistanceControl,
    ForceControl,
    Hold,
)
from palpate.workers.mechanics.fem.plate_contact import PENALTY_N_PER_MM3
from tests.workers.mechanics.fem.solids import FAR, body, box


def slab(axis: int, at: float) -> Box:
    """Return the box of all points with this coordinate."""
    low, high = [-FAR] * 3, [FAR] * 3
    low[axis], high[axis] = at - 1e-6, at + 1e-6
    return Box(tuple(low), tuple(high))


def pads_of(found: Equilibrium) -> list[tuple[FloatArray, FloatArray]]:
    """Return normal force, (c,), and friction on the body, (c, 3), of each plate in N."""
    level, state = found.levels[-1], found.states[-1]
    plate_contacts = level.energy(state, found.stage).plate_contacts
    return [
        (p.normal_force, -friction.potential(state.x, state.travel_mm).force)
        for p, friction in zip(plate_contacts, state.history.friction, strict=True)
    ]


def settled(model, problem) -> Equilibrium:
    found = equilibrium(model, problem)
    assert found.solution.outcome.converged, found.solution.outcome.reason
    return found


def test_infinite_friction_is_glue():
    """It is equivalent to faces held in their plane."""
    L, d = 20.0, 2.0
    c = {Tissue.FAT: Constants(1e-3, 0.45)}
    model = body([(4, 4, 4)], box(20.0, L, 20.0, origin=(-10.0, 0.0, 0.0)))
    rough = DistanceControl(0.0, L - d, Device(friction=1e3))
    stuck = settled(model, Problem(c, rough, tolerance_mm=1e-4))
    faces = (Hold(slab(1, 0.0)), Hold(slab(1, L), (0.0, -d, 0.0)))
    # These plates never touch: the faces are displaced instead.
    far = DistanceControl(-100.0, 100.0)
    held = settled(model, Problem(c, far, holds=faces, tolerance_mm=1e-6))
    free = settled(model, Problem(c, DistanceControl(0.0, L - d), tolerance_mm=1e-5))
    u, v = stuck.solution.displacement_mm, held.solution.displacement_mm
    bulge = np.abs(v - free.solution.displacement_mm).max()
    assert bulge > 0.3
    np.testing.assert_allclose(u, v, atol=0.02 * bulge)


def test_friction_is_inside_its_cone():
    model = body([(4, 4, 4)], box(20.0, 20.0, 20.0, origin=(-10.0, 0.0, 0.0)), jitter=0.1)
    mu = 0.15
    load = ForceControl(1.0, 0.0, 20.0, Device(friction=mu))
    problem = Problem({Tissue.FAT: Constants(0.01, 0.49)}, load, tolerance_mm=1e-4)
    found = settled(model, problem)
    for normal, drag in pads_of(found):
        size = np.linalg.norm(drag, axis=1)
        assert (size <= mu * normal * (1 + 1e-3) + 1e-9).all()
        assert (size > 0.9 * mu * normal)[normal > 0].any()
        np.testing.assert_allclose(drag[:, 1], 0, atol=1e-12)
        assert not size[normal == 0].any()


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_dragged_block_slips_on_both_plates(way):
    """Pulling its middle 30 mm along x takes mu times both normal forces."""
    L, mu = 20.0, 0.1
    model = body([(4, 4, 2)], box(20.0, L, 10.0, origin=(-10.0, 0.0, 0.0)))
    pull = Hold(slab(1, L / 2), (way * 30.0, 0.0, 0.0), (True, False, False))
    problem = Problem(
        {Tissue.FAT: Constants(1.0, 0.45)},
        DistanceControl(0.0, L - 0.4, Device(friction=mu)),
        holds=(pull,),
        tolerance_mm=1e-4,
    )
    found = settled(model, problem)
    level, state = found.levels[-1], found.states[-1]
    middle = np.abs(level.model.nodes[:, 1] - L / 2) < 1e-6
    force = level.force(state, level.energy(state, found.stage), found.stage)
    normal = sum(load.sum() for load, _ in pads_of(found))
    assert normal > 0.1
    assert force[middle, 0].sum() == pytest.approx(way * mu * normal, rel=2e-3)
    for load, drag in pads_of(found):
        at = load > 0
        np.testing.assert_allclose(drag[at, 0], -way * mu * load[at], rtol=5e-3)


def test_pressure_forms_a_friction_hill():
    """Pressure rises from the edge of a thin strip as in the slab method.

    A strip of half width w and height h is squeezed by d, plane strain along z. With
    the stress s_x averaged over the height, h s_x' = 2 mu p (von Karman 1925; Siebel
    1932), and in place of yield the elastic p = p0 - r s_x, r = nu / (1 - nu),
    p0 = E / (1 - nu^2) d / h. So p = p0 exp(2 mu r (w - x) / h).
    """
    w, h, depth, mu = 200.0, 40.0, 20.0, 0.1
    E, nu, d = 0.1, 0.45, 0.4
    r = nu / (1 - nu)
    slope = 2 * mu * r / h
    p0 = E / (1 - nu**2) * d / (h + 2 * E / (1 - nu**2) / PENALTY_N_PER_MM3)
    # Half of the strip, from its middle to the edge.
    model = body([(10, 2, 1), (20, 4, 1)], box(w, h, depth))
    problem = Problem(
        {Tissue.FAT: Constants(E, nu)},
        DistanceControl(0.0, h - d, Device(friction=mu)),
        holds=(
            Hold(slab(0, 0.0), axes=(True, False, False)),
            Hold(EVERYWHERE, axes=(False, False, True)),
        ),
        tolerance_mm=1e-3,
    )
    force = solve(model, problem).outcome.plate_force_n
    exact = depth * p0 * (np.exp(slope * w) - 1) / slope
    smooth = depth * p0 * w
    assert exact > 1.3 * smooth
    assert force == pytest.approx(exact, rel=0.03)


@pytest.mark.slow
def test_travel_converges_with_load_steps():
    model = body([(3, 3, 3)], box(200.0, 150.0, 100.0, origin=(-100.0, 0.0, 0.0)))
    c = {Tissue.FAT: Constants(0.005, 0.45)}

    def travel(mu: float, steps: int = 8) -> float:
        load = ForceControl(40.0, 0.0, 150.0, Device(friction=mu))
        problem = Problem(c, load, tolerance_mm=1e-3, friction_steps=steps)
        found = settled(model, problem)
        return found.solution.outcome.plate_displacement_mm

    found = [travel(0.3, steps) for steps in (4, 8, 16, 32)]
    assert found[0] < 0.9 * travel(0.0)
    assert np.ptp(found) < 0.003 * found[-1]
