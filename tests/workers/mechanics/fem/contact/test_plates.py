"""Tilted plates, bowed plates, and two moving plates."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import FloatArray, Tissue
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium, solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, FibreField, Problem
from palpate.workers.mechanics.fem.discretisation import Stage, State
from palpate.workers.mechanics.fem.loads_and_regions import (
    Box,
    Device,
    DistanceControl,
    ForceControl,
    Hold,
    Plate,
    Wall,
)
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.plate_contact import (
    PENALTY_N_PER_MM3,
    PlateContact,
    edge_stiffness,
    penalty_potential,
    plate_contact,
)
from palpate.workers.mechanics.fem.plate_surface import (
    EDGE_RADIUS_MM,
    NO_FACES,
    ContactFaces,
    ContactNodes,
    ContactPotential,
    Gap,
    plate_surfaces,
)
from tests.workers.mechanics.fem.solids import FAR, Shape, body, box, rotation, turned

CLAMPED = Wall(held=(True, True, True))
SOFT = {Tissue.FAT: Constants(0.01, 0.45, fibre_mpa=0.01)}


def contact_forces(found: Equilibrium) -> list[tuple[FloatArray, FloatArray]]:
    """Return positions of the lower and upper pads, and the forces on them in N."""
    state = found.states[-1]
    plate_contacts = found.levels[-1].energy(state, found.stage).plate_contacts
    return [(state.x[p.nodes.index], -penalty_potential(p).force) for p in plate_contacts]


def test_oblique_device_and_rotated_body_give_the_rotated_solution():
    """Rotated by -45 degrees about z, cranio-caudal becomes mediolateral oblique."""
    R = rotation((0.0, 0.0, 1.0), -45.0)
    found = []
    for Q in (np.eye(3), R):
        device = Device(
            axis=tuple(Q @ [0.0, 1.0, 0.0]),
            pivot_mm=tuple(Q @ [2.0, 1.0, 5.0]),
            lower=Plate((2.0, -1.0)),
            upper=Plate((3.0, 4.0), (0.004, -0.006)),
            lower_share=0.3,
        )
        problem = Problem(
            SOFT,
            ForceControl(1.0, 0.0, 10.0, device),
            wall=CLAMPED,
            fibres=FibreField(tuple(Q @ [0.3, 0.2, 1.0])),
            gravity_g=tuple(Q @ [0.3, -1.0, 0.5]),
            tolerance_mm=1e-6,
        )
        model = body([(3, 3, 3)], turned(box(12.0, 10.0, 10.0, origin=(-6.0, 0.0, 0.0)), Q))
        solution = solve(model, problem)
        assert solution.outcome.converged, solution.outcome.reason
        found.append(solution)
    straight, oblique = found
    assert np.abs(straight.displacement_mm).max() > 0.5
    np.testing.assert_allclose(oblique.displacement_mm, straight.displacement_mm @ R.T, atol=1e-5)
    assert oblique.outcome.plate_displacement_mm == pytest.approx(
        straight.outcome.plate_displacement_mm, abs=1e-5
    )


@pytest.mark.parametrize("about", [0, 1])
def test_two_equally_tilted_plates_are_a_rotated_device(about):
    """The planes are the same: normal R y, at the distances lower and upper times cos."""
    degrees = 5.0
    tilt = (degrees, 0.0) if about == 0 else (0.0, degrees)
    R = rotation((1.0, 0.0, 0.0) if about == 0 else (0.0, 0.0, 1.0), degrees)
    model = body([(3, 3, 3)], box(12.0, 10.0, 10.0, origin=(-6.0, 0.0, 0.0)))
    cos = np.cos(np.radians(degrees))
    tilted = DistanceControl(0.3, 8.5, Device(lower=Plate(tilt), upper=Plate(tilt)))
    turned_load = DistanceControl(0.3 * cos, 8.5 * cos, Device(axis=tuple(R @ [0.0, 1.0, 0.0])))
    found = [
        equilibrium(model, Problem(SOFT, load, wall=CLAMPED, tolerance_mm=1e-6))
        for load in (tilted, turned_load)
    ]
    for each in found:
        assert each.solution.outcome.converged, each.solution.outcome.reason
        for sign, (_, force) in zip((1, -1), contact_forces(each), strict=True):
            total = force.sum(axis=0)
            np.testing.assert_allclose(total, sign * np.linalg.norm(total) * R[:, 1], atol=1e-12)
    np.testing.assert_allclose(found[0].states[-1].x, found[1].states[-1].x, atol=1e-5)


@pytest.mark.parametrize("edge", [None, 4.0])
def test_plates_and_wall_balance_force_and_moment(edge):
    device = Device(lower=Plate((2.0, -3.0)), upper=Plate((-4.0, 6.0), (0.01, 0.02)), edge_mm=edge)
    model = body([(4, 4, 4)], box(12.0, 10.0, 10.0, origin=(-6.0, 0.0, 0.0)), jitter=0.2)
    problem = Problem(SOFT, ForceControl(0.3, -1, 11, device), wall=CLAMPED, tolerance_mm=1e-7)
    found = equilibrium(model, problem)
    level, state = found.levels[-1], found.states[-1]
    wall = level.model.wall
    reaction = level.force(state, level.energy(state, found.stage), found.stage)[wall]
    parts = [*contact_forces(found), (state.x[wall], reaction)]
    force = sum(f.sum(axis=0) for _, f in parts)
    moment = sum(np.cross(x, f).sum(axis=0) for x, f in parts)
    assert np.linalg.norm(reaction.sum(axis=0)) > 0.01
    np.testing.assert_allclose(force, 0, atol=1e-6)
    np.testing.assert_allclose(moment, 0, atol=1e-5)


def test_small_tilt_bends_the_block():
    """Between frictionless plates with a tilt t between them a block bends like a beam.

    u_y = (-d + t x) y / L is exact in linear elasticity, so M = E I t / L and the force
    stays E A d / L. The penalty is an elastic layer at both ends: L becomes L + 2 E / k.
    """
    a, L, b = 12.0, 10.0, 6.0
    E, tilt_deg, d = 1e-3, 0.1, 0.05
    middle = Hold(Box((-1e-6, -FAR, -FAR), (1e-6, 1e-6, FAR)), axes=(True, False, False))
    length = L + 2 * E / PENALTY_N_PER_MM3
    force_error, moment_error = [], []
    for n in (4, 8):
        model = body([(n, n, n // 2)], box(a, L, b, origin=(-a / 2, 0.0, 0.0)))
        device = Device(upper=Plate((0.0, tilt_deg)))
        load = DistanceControl(0.0, L - d, device)
        problem = Problem({Tissue.FAT: Constants(E, 0.3)}, load, holds=(middle,), tolerance_mm=1e-7)
        found = equilibrium(model, problem)
        assert found.solution.outcome.converged, found.solution.outcome.reason
        x, force = contact_forces(found)[1]
        moment = np.cross(x, force).sum(axis=0)[2]
        exact = E * b * a**3 / 12 * np.radians(tilt_deg) / length
        moment_error.append(moment / exact - 1)
        force_error.append(-force.sum(axis=0)[1] / (E * a * b * d / length) - 1)
    assert abs(force_error[1]) < 0.01
    coarse, fine = moment_error
    assert np.log2(coarse / fine) == pytest.approx(2, abs=0.2)
    assert abs((4 * fine - coarse) / 3) < 0.01


def test_two_moving_plates_equal_one_and_a_shift():
    model = body([(3, 3, 3)], box(12.0, 10.0, 10.0, origin=(-6.0, 0.0, 0.0)), jitter=0.2)
    found = []
    for share in (0.0, 0.5):
        load = ForceControl(0.3, 0.0, 10.0, Device(lower_share=share))
        solution = solve(model, Problem(SOFT, load, tolerance_mm=1e-7))
        assert solution.outcome.converged, solution.outcome.reason
        found.append(solution)
    one, two = found
    travel = one.outcome.plate_displacement_mm
    assert travel > 1.0
    assert two.outcome.plate_displacement_mm == pytest.approx(travel, abs=1e-6)
    shift = two.displacement_mm - one.displacement_mm
    np.testing.assert_allclose(shift - [0.0, travel / 2, 0.0], 0, atol=1e-5)


def test_force_of_a_bowed_plate_follows_the_volume_of_its_cap():
    """On a body that has not moved, the depth d - (c1 x^2 + c2 z^2) / 2 over its ellipse
    has the volume pi d^2 / sqrt(c1 c2); the penalty makes a force of it."""
    c1, c2, d = 0.02, 0.03, 0.5
    model = body([(40, 1, 40)], box(20.0, 5.0, 20.0, origin=(-10.0, 0.0, 0.0))).finest
    device = Device(pivot_mm=(0.0, 0.0, 10.0), upper=Plate(bow_per_mm=(c1, c2)))
    load = DistanceControl(0.0, 5.0 - d, device)
    stage = Stage(Gap(load.lower_mm, load.upper_mm), None, 1.0, device)
    at = Level.build(model, Problem(SOFT, load)).energy(State(model.nodes, 0.0), stage)
    exact = PENALTY_N_PER_MM3 * np.pi * d**2 / np.sqrt(c1 * c2)
    assert at.plate_forces[1] == pytest.approx(exact, rel=0.01)
    assert at.plate_contacts[1].penetration.max() == pytest.approx(d, abs=1e-12)


def test_edge_through_the_pivot_steepens_half_of_the_cap():
    """Behind it the rounding adds to the curvature along z: half of each volume."""
    c1, c2, d = 0.02, 0.03, 0.5
    model = body([(40, 1, 40)], box(20.0, 5.0, 20.0, origin=(-10.0, 0.0, 0.0))).finest
    device = Device(pivot_mm=(0.0, 0.0, 10.0), upper=Plate(bow_per_mm=(c1, c2)), edge_mm=10.0)
    stage = Stage(Gap(0.0, 5.0 - d), None, 1.0, device)
    load = DistanceControl(0.0, 5.0 - d, device)
    at = Level.build(model, Problem(SOFT, load)).energy(State(model.nodes, 0.0), stage)
    behind = c2 + 1 / EDGE_RADIUS_MM
    exact = PENALTY_N_PER_MM3 * np.pi * d**2 * (1 / np.sqrt(c1 * c2) + 1 / np.sqrt(c1 * behind)) / 2
    assert at.plate_forces[1] == pytest.approx(exact, rel=0.01)


def flat_skin(spacing_mm: float, rows: int) -> tuple[FloatArray, ContactNodes]:
    """Return the lower face of a body, in squares of two triangles: nodes (n, 3) and contact."""
    i, j = np.meshgrid(np.arange(rows), np.arange(rows), indexing="ij")
    nodes = spacing_mm * np.stack([i, np.zeros_like(i), j], axis=2).reshape(-1, 3).astype(float)
    first = (i * rows + j)[:-1, :-1].ravel()
    near, far = ([first, first + rows, first + 1], [first + rows, first + rows + 1, first + 1])
    faces = np.concatenate([np.stack(near, axis=1), np.stack(far, axis=1)])
    stiffness = np.full(len(faces), PENALTY_N_PER_MM3 * spacing_mm**2 / 2)
    of_nodes = np.bincount(faces.ravel(), np.repeat(stiffness / 3, 3))
    index = np.arange(len(nodes), dtype=np.int32)
    return nodes, ContactNodes(index, of_nodes, ContactFaces(faces, stiffness))


def test_contact_at_an_edge_is_independent_of_rows_of_nodes():
    """Skin at a depth d inside a plate touches its rounding until that has risen by d: the
    force is the penalty times d w + (2 d / 3) sqrt(2 R d) per length, with the width w in front
    of the edge. Nodes alone lose contact row by row, an error of 1.6 mm in the width."""
    d, spacing, rows = 0.1, 6.0, 7
    skin, nodes = flat_skin(spacing, rows)
    alone = replace(nodes, faces=NO_FACES)
    side = spacing * (rows - 1)
    off = []
    for edge_mm in np.linspace(12.0, 24.0, 25):
        lower, _ = plate_surfaces(Device(edge_mm=edge_mm), Gap(d, 20.0))
        width = side - edge_mm + 2 / 3 * np.sqrt(2 * EDGE_RADIUS_MM * d)
        forces = [plate_contact(n, skin, lower).normal_force.sum() for n in (nodes, alone)]
        off.append(np.array(forces) / (PENALTY_N_PER_MM3 * d * side) - width)
    with_faces, with_nodes = np.sqrt(np.mean(np.square(off), axis=0))
    assert with_nodes > 1.5
    assert with_faces < 1.1


def contacts_at_an_edge(by: float) -> tuple[list[PlateContact], FloatArray, float]:
    """Return contacts of a rough body, moved by part of a random motion, and edged, tilted plates.

    Also return the motion of the contact nodes and the corresponding travel.
    """
    device = Device(upper=Plate((2.0, -3.0), (-0.01, -0.02)), edge_mm=4.0)
    model = body([(3, 3, 6)], box(12.0, 10.0, 10.0, origin=(-6.0, 0.0, 0.0)), jitter=0.2).finest
    rng = np.random.default_rng(5)
    x = model.nodes + 0.3 * rng.standard_normal(model.nodes.shape)
    step, travel = rng.standard_normal(x.shape), 0.7
    plates = plate_surfaces(device, Gap(0.5, 9.0).closed_by(by * travel))
    contacts = [plate_contact(model.contact_nodes, x + by * step, p) for p in plates]
    return contacts, step[model.contact_nodes.index], travel


def stiffness_times(contact: PlateContact, moved: FloatArray, *, convex: bool) -> FloatArray:
    """Return the stiffness of nodes and of faces at the edge times a motion, both (c, 3)."""
    own = penalty_potential(contact).stiffness
    if convex:
        own = own - edge_stiffness(contact)
    force = np.einsum("cij,cj->ci", own, moved)
    assert contact.at_edge is not None
    faces, corners = contact.at_edge.stiffness(convex=convex), contact.at_edge.corners
    np.add.at(force, corners, np.einsum("fabij,fbj->fai", faces, moved[corners]))
    return force


def test_force_at_an_edge_is_the_derivative_of_its_energy():
    def potential(by: float) -> ContactPotential:
        lower, upper = contacts_at_an_edge(by)[0]
        return penalty_potential(lower) + penalty_potential(upper)

    h = 1e-5
    here, more, less = potential(0.0), potential(h), potential(-h)
    contacts, moved, travel = contacts_at_an_edge(0.0)
    assert all(0.1 < c.at_edge.share.max() < 0.9 for c in contacts if c.at_edge)
    slope = (here.force * moved).sum() + here.travel_force * travel
    assert (more.energy - less.energy) / (2 * h) == pytest.approx(slope, rel=1e-7)
    expected = sum(stiffness_times(c, moved, convex=False) for c in contacts)
    expected = expected + here.coupling * travel
    assert (more.force - less.force) / (2 * h) == pytest.approx(expected, rel=1e-6, abs=1e-6)
    on_plate = (here.coupling * moved).sum() + here.travel_stiffness * travel
    assert (more.travel_force - less.travel_force) / (2 * h) == pytest.approx(on_plate, rel=1e-6)


def test_normal_force_change_at_an_edge_equals_differences():
    """Friction needs this derivative."""
    h = 1e-5
    contacts, moved, travel = contacts_at_an_edge(0.0)
    pairs = zip(contacts_at_an_edge(h)[0], contacts_at_an_edge(-h)[0], strict=True)
    for contact, (more, less) in zip(contacts, pairs, strict=True):
        expected = contact.normal_force_change(moved, travel)
        found = (more.normal_force - less.normal_force) / (2 * h)
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_contact_without_edge_terms_is_convex():
    """The terms that Newton's method omits far from equilibrium are all that may make a plate's
    tangent indefinite, including the plate's own travel."""
    contact, moved, _ = contacts_at_an_edge(0.0)
    lower = contact[1]
    c = len(moved)
    units = np.eye(3 * c).reshape(-1, c, 3)
    whole, rest = (
        np.array([stiffness_times(lower, u, convex=convex).ravel() for u in units])
        for convex in (False, True)
    )
    potential = penalty_potential(lower)
    border = (potential.coupling - lower.at_edge.share_coupling).ravel()
    rest -= np.outer(border, border) / potential.travel_stiffness
    assert np.linalg.eigvalsh(whole)[0] < -1e-3
    assert np.linalg.eigvalsh(rest)[0] > -1e-9 * np.abs(whole).max()


@pytest.mark.slow
def test_body_yields_smoothly_as_the_edge_recedes():
    """From no edge at all, over rows of nodes 4 mm apart."""
    model = body([(3, 4, 3), (6, 8, 6)], box(24.0, 32.0, 24.0, origin=(-12.0, 0.0, 0.0)))
    constants = {Tissue.FAT: Constants(0.01, 0.49)}
    found = []
    for edge_mm in [None, *np.arange(0.0, 10.1, 0.5)]:
        load = ForceControl(1.0, 0.0, 32.0, Device(edge_mm=edge_mm))
        solution = solve(model, Problem(constants, load))
        assert solution.outcome.converged, solution.outcome.reason
        found.append(solution.displacement_mm)
    moved = [np.abs(b - a).max() for a, b in itertools.pairwise(found)]
    assert moved[0] < 1e-3
    assert max(moved) < 1.0


def bowed_top(bow: tuple[float, float], size: tuple[float, float, float]) -> Shape:
    """Return a block whose upper face is raised by bow_1 x^2 / 2 + bow_2 z^2 / 2."""
    flat = box(*size, origin=(-size[0] / 2, 0.0, 0.0))

    def shape(unit: FloatArray) -> FloatArray:
        x = flat(unit)
        rise = (bow[0] * x[:, 0] ** 2 + bow[1] * x[:, 2] ** 2) / 2
        x[:, 1] *= 1 + rise / size[1]
        return x

    return shape


def test_bowed_plate_equals_a_flat_plate_on_a_bowed_body():
    """For small strains only the distance between body and plate matters."""
    size, bow = (12.0, 10.0, 8.0), (0.004, 0.002)
    pressed = 9.8
    c = {Tissue.FAT: Constants(0.001, 0.4)}

    def press(shape: Shape, device: Device) -> float:
        problem = Problem(c, DistanceControl(0.0, pressed, device), tolerance_mm=1e-6)
        solution = solve(body([(4, 4, 3)], shape), problem)
        assert solution.outcome.converged, solution.outcome.reason
        return solution.outcome.plate_force_n

    flat = box(*size, origin=(-6.0, 0.0, 0.0))
    opposite = (-bow[0], -bow[1])
    bowed_plate = press(flat, Device(upper=Plate(bow_per_mm=opposite)))
    bowed_body = press(bowed_top(bow, size), Device())
    neither = press(flat, Device())
    assert bowed_plate > 1.2 * neither
    assert bowed_body == pytest.approx(bowed_plate, rel=0.02)


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("force_n", [0.001, 0.03, 0.3])
def test_body_touching_the_fixed_plate_is_compressed_as_in_linear_elasticity(force_n, share):
    """Only the moving plate presses at first. Small strains: E A d / L."""
    E, side = 0.01, 20.0
    model = body([(4, 4, 4)], box(side, side, side, origin=(-10.0, 0.0, 0.0)), jitter=0.1)
    load = ForceControl(force_n, 0.0, side, Device(lower_share=share))
    problem = Problem({Tissue.FAT: Constants(E, 0.49)}, load, tolerance_mm=1e-6)
    outcome = solve(model, problem).outcome
    assert outcome.converged, outcome.reason
    stiffness = side**2 / (side / E + 2 / PENALTY_N_PER_MM3)
    strain = force_n / (E * side**2)
    expected = force_n / stiffness
    assert outcome.plate_displacement_mm == pytest.approx(expected, rel=0.005 + 1.1 * strain)
