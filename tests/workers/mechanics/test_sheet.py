"""A thin sheet deforms in plane stress, whatever its law and mesh."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.boundary_value_problem import (
    Change,
    Constants,
    Gradient,
    Membrane,
    Problem,
)
from palpate.workers.mechanics.fem.loads_and_regions import (
    Box,
    DeadForce,
    DisplacementField,
    Hold,
    NoPlates,
    Pressure,
    Wall,
)
from palpate.workers.mechanics.materials.elastic_law import plane_stress
from palpate.workers.mechanics.materials.law_fit import DeformationMode, nominal_stress_mpa
from palpate.workers.mechanics.materials.law_plugins import law_named
from palpate.workers.mechanics.sheet_equilibrium import equilibrium
from palpate.workers.mechanics.sheet_mesh import sheet_mesh

LENGTH, WIDTH, THICKNESS = 40.0, 20.0, 0.5
E, NEARLY = 0.1, 0.499999
RECTANGLE = np.array([[0, 0], [LENGTH, 0], [LENGTH, WIDTH], [0, WIDTH]], float)
ACROSS = np.array([[13.0, -5.0], [13.0, 25.0]])
LAWS = ("fung", "mooney-rivlin", "neo-hookean", "ogden", "yeoh")


@pytest.fixture(scope="module")
def strip():
    return sheet_mesh(RECTANGLE, [ACROSS], 300, THICKNESS)


def side(axis, at, everywhere=np.inf):
    """Return the region of nodes at one coordinate."""
    low, high = np.full(3, -everywhere), np.full(3, everywhere)
    low[axis], high[axis] = at - 1e-3, at + 1e-3
    return Box(tuple(low), tuple(high))


def pulled(along, across=None, constants=None, **rest):
    """Return a problem of a strip stretched along x, with free or prescribed width."""
    holds = [
        Hold(side(0, 0.0), axes=(True, False, False)),
        Hold(side(1, 0.0), axes=(False, True, False)),
        Hold(side(0, LENGTH), ((along - 1) * LENGTH, 0, 0), (True, False, False)),
    ]
    if across is not None:
        holds.append(Hold(side(1, WIDTH), (0, (across - 1) * WIDTH, 0), (False, True, False)))
    return problem(constants or Constants(E, NEARLY), holds=tuple(holds), **rest)


def problem(constants, **rest):
    walls = Wall((False, False, False))
    return Problem({Tissue.FAT: constants}, NoPlates(), wall=walls, **rest)


def with_law(name, poisson=NEARLY):
    """Return constants of a law, away from its neo-Hookean limit."""
    plugin, constants = law_named(name), Constants(E, poisson)
    shape = {p.name: p.neutral + 0.3 * (p.upper - p.neutral) for p in plugin.parameters}
    law = plugin.law(constants.mu_mpa, shape)
    return Constants(E, poisson, law=law), law


def force_on(at, nodes, axis):
    return at.reactions[nodes, axis].sum()


def test_elastic_bed_spreads_a_pull_over_its_characteristic_length():
    """A narrow strip on a bed follows E t u'' = k u: u = U sinh(x / l) / sinh(L / l)."""
    narrow = np.array([[0, 0], [LENGTH, 0], [LENGTH, 1.0], [0, 1.0]])
    sheet = sheet_mesh(narrow, [], 900, THICKNESS)
    stiffness, pull = 5e-4, 0.01
    spread = np.sqrt(E * THICKNESS / stiffness)
    holds = (
        Hold(side(0, 0.0), axes=(True, False, False)),
        Hold(side(0, LENGTH), (pull, 0, 0), (True, False, False)),
    )
    bed = Wall((False, False, False), (stiffness, stiffness, 0.0))
    given = replace(problem(Constants(E, 0.3), holds=holds), wall=bed)
    at = equilibrium(sheet, given)
    exact = pull * np.sinh(sheet.nodes[:, 0] / spread) / np.sinh(LENGTH / spread)
    np.testing.assert_allclose(at.solution.displacement_mm[:, 0], exact, atol=0.002 * pull)
    softer, stiffer = (
        replace(given, wall=replace(bed, spring_mpa_per_mm=(k, k, 0.0)))
        for k in (0.99 * stiffness, 1.01 * stiffness)
    )
    (moved,), _ = at.tangents([Change(stiffer, softer, 0.02 * stiffness)])
    ahead, behind = (equilibrium(sheet, one).solution.displacement_mm for one in (stiffer, softer))
    by_hand = (ahead - behind) / (0.02 * stiffness)
    np.testing.assert_allclose(moved, by_hand, atol=2e-3 * np.abs(by_hand).max())


def test_patch_of_irregular_triangles_deforms_affinely(strip):
    """An affine border displacement gives an affine interior with uniform stress."""
    affine = np.array([[0.3, 0.1, 0], [-0.05, -0.2, 0], [0, 0, 0]])
    corners = tuple((x, y, 0.0) for x, y in RECTANGLE)
    moved = tuple(tuple(map(float, affine @ corner)) for corner in corners)
    sides = [side(0, 0.0), side(0, LENGTH), side(1, 0.0), side(1, WIDTH)]
    holds = tuple(Hold(one, DisplacementField(corners, moved)) for one in sides)
    at = equilibrium(strip, problem(Constants(E, 0.4), holds=holds))
    assert at.solution.outcome.converged
    np.testing.assert_allclose(at.solution.displacement_mm, strip.nodes @ affine.T, atol=1e-9)
    assert np.ptp(at.response.stress, axis=0).max() < 1e-10
    np.testing.assert_allclose(at.reactions.sum(axis=0), 0, atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stretch", [0.8, 1.3])
def test_stretched_strip_follows_the_closed_form_of_its_law(strip, law, stretch):
    """F = P A with P of an incompressible body, uniaxial and equibiaxial."""
    constants, own = with_law(law)
    right, top = strip.nodes[:, 0] > LENGTH - 1e-6, strip.nodes[:, 1] > WIDTH - 1e-6
    uniaxial = equilibrium(strip, pulled(stretch, constants=constants))
    P = float(nominal_stress_mpa(own, DeformationMode.UNIAXIAL, np.array(stretch)))
    assert force_on(uniaxial, right, 0) == pytest.approx(P * WIDTH * THICKNESS, rel=1e-4)
    assert uniaxial.response.thickness_stretch == pytest.approx(stretch**-0.5, rel=1e-4)
    both = equilibrium(strip, pulled(stretch, stretch, constants))
    P = float(nominal_stress_mpa(own, DeformationMode.EQUIBIAXIAL, np.array(stretch)))
    assert force_on(both, right, 0) == pytest.approx(P * WIDTH * THICKNESS, rel=1e-4)
    assert force_on(both, top, 1) == pytest.approx(P * LENGTH * THICKNESS, rel=1e-4)


def test_compressible_strip_has_its_modulus_and_poisson_ratio(strip):
    """F = E A eps, and the width shrinks by nu eps, for a small strain."""
    eps, nu = 1e-5, 0.3
    at = equilibrium(strip, pulled(1 + eps, constants=Constants(E, nu)))
    right, top = strip.nodes[:, 0] > LENGTH - 1e-6, strip.nodes[:, 1] > WIDTH - 1e-6
    assert force_on(at, right, 0) == pytest.approx(E * eps * WIDTH * THICKNESS, rel=1e-4)
    narrower = at.solution.displacement_mm[top, 1] / WIDTH
    assert narrower == pytest.approx(-nu * eps, rel=1e-4)


def test_force_and_displacement_give_the_same_stiffness(strip):
    """A force moves the end by the displacement that needs this force."""
    moved = equilibrium(strip, pulled(1.25))
    right = strip.nodes[:, 0] > LENGTH - 1e-6
    force = DeadForce((force_on(moved, right, 0), 0, 0), side(0, LENGTH))
    holds = pulled(1.0).holds[:2]
    pushed = equilibrium(strip, problem(Constants(E, NEARLY), holds=holds, forces=(force,)))
    there = pushed.solution.displacement_mm
    np.testing.assert_allclose(there, moved.solution.displacement_mm, atol=1e-7)


def test_weight_stretches_a_hanging_sheet_like_a_bar(strip):
    """u(L) = rho g L^2 / 2 E of a hanging bar, for nu near 0 and a small weight."""
    holds = (
        Hold(side(0, 0.0), axes=(True, False, False)),
        Hold(side(1, 0.0), axes=(False, True, False)),
    )
    heavy = problem(Constants(E, 0.01), holds=holds, gravity_g=(0.01, 0, 0))
    at = equilibrium(strip, heavy)
    tip = at.solution.displacement_mm[strip.nodes[:, 0] > LENGTH - 1e-6, 0].mean()
    assert tip == pytest.approx(1e-9 * 98.0665 * LENGTH**2 / 2 / E, rel=1e-3)


@pytest.mark.parametrize("law", LAWS)
def test_stress_and_tangent_are_derivatives(law):
    """S = 2 dW/dC from the work of small strains, and its tangent, by differences."""
    constants, own = with_law(law, poisson=0.45)
    kappa = constants.kappa_mpa
    C = np.array([[[1.5, 0.2], [0.2, 0.9]]])
    at = plane_stress(C, own, kappa)

    def energy(C):
        across = plane_stress(C, own, kappa).thickness_stretch
        F = np.zeros((1, 3, 3))
        F[:, :2, :2] = np.linalg.cholesky(C).swapaxes(1, 2)
        F[:, 2, 2] = across
        return (own.energy(F) + kappa / 2 * (np.linalg.det(F) - 1) ** 2)[0]

    h = 1e-5
    for entry, dC in enumerate(([[2, 0], [0, 0]], [[0, 0], [0, 2]], [[0, 1], [1, 0]])):
        step = h * np.array([dC])
        slope = (energy(C + step) - energy(C - step)) / (2 * h)
        assert at.stress[0, entry] == pytest.approx(slope, rel=1e-6)
        ends = [plane_stress(C + sign * step, own, kappa).stress[0] for sign in (1, -1)]
        np.testing.assert_allclose(
            at.tangent[0, :, entry], (ends[0] - ends[1]) / (2 * h), rtol=1e-6, atol=1e-9
        )


CHANGES = {
    "stiffness": lambda h: pulled(1.3, constants=Constants(E * (1 + h), 0.4)),
    "compressibility": lambda h: pulled(1.3, constants=Constants(E, 0.4 + h)),
    "motion": lambda h: pulled(1.3 + h, constants=Constants(E, 0.4)),
    "gradient": lambda h: pulled(1.3, constants=Constants(E, 0.4), variations=(_graded(h),)),
    "weight": lambda h: pulled(1.3, constants=Constants(E, 0.4), gravity_g=(0, 5 * h, 0)),
    "pressure": lambda h: pulled(
        1.3, 1.1, constants=Constants(E, 0.4), pressures=(Pressure(1e-5 * (1 + h)),)
    ),
}


def _graded(h):
    frame = sheet_mesh(RECTANGLE, [], 300, THICKNESS).frame
    return Gradient((h, 0.5 * h, 0.0), frame)


@pytest.mark.parametrize("name", [*CHANGES])
def test_tangents_of_nodes_and_reactions_agree_with_differences(strip, name):
    make = CHANGES[name]
    h = 1e-4
    ends = tuple(Hold(side(0, x), axes=(False, False, True)) for x in (0.0, LENGTH))

    def solved(value):
        stated = make(value)
        return equilibrium(strip, replace(stated, holds=(*stated.holds, *ends)))

    at, ahead, behind = solved(0.0), solved(h), solved(-h)
    moved, forces = at.tangents([Change(ahead.problem, behind.problem, 2 * h)])
    u = (ahead.solution.displacement_mm - behind.solution.displacement_mm) / (2 * h)
    r = (ahead.reactions - behind.reactions) / (2 * h)
    np.testing.assert_allclose(moved[0], u, atol=1e-5 * max(1.0, np.abs(u).max()))
    np.testing.assert_allclose(forces[0], r, atol=1e-5 * max(1e-3, np.abs(r).max()))


# --- inflation of a circular membrane ---
RADIUS, THIN = 10.0, 0.1
CORNERS = 72


def inflated(nodes, pressure_mpa):
    angle = np.linspace(0, 2 * np.pi, CORNERS, endpoint=False)
    outline = RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])
    rim = tuple(Hold(_Side(a, b)) for a, b in zip(outline, np.roll(outline, -1, 0), strict=True))
    model = sheet_mesh(outline, [], nodes, THIN)
    loads = {"holds": rim, "pressures": (Pressure(pressure_mpa),)}
    return equilibrium(model, problem(Constants(E, NEARLY), **loads))


class _Side:
    """Region of the nodes on one side of the polygon."""

    def __init__(self, a, b):
        self.a, self.b = a, b

    def contains(self, points, margin_mm=0.0):
        along = self.b - self.a
        t = np.clip((points[:, :2] - self.a) @ along / (along @ along), 0, 1)
        away = np.hypot(*(points[:, :2] - self.a - t[:, None] * along).T)
        return away < 1e-6 + margin_mm


def height_by_shooting(pressure_mpa):
    """Return the height of an axisymmetric incompressible neo-Hookean membrane by shooting.

    Equilibrium of a shell of revolution (J. E. Adkins and R. S. Rivlin, Phil. Trans. R. Soc. A
    244 (1952) 505) in the undeformed radius R, with meridional and hoop stretch l1 and l2 = r/R,
    Cauchy tensions T1 and T2 per length, and the angle t of the meridian to the plane:

        dr/dR = l1 cos t,  dz/dR = -l1 sin t,
        d(T1 r)/dR = T2 l1 cos t,  T1 r sin t = p r^2 / 2.
    """
    mu = E / 3

    def tension(l1, l2):  # T1
        return mu * THIN * (l1 / l2 - 1 / (l1**3 * l2**3))

    def slopes(R, y):
        r, _, pull = y  # pull = T1 r
        l2 = r / R
        T1 = pull / r
        l1 = brentq(lambda l: tension(l, l2) - T1, 0.3, 20)
        T2 = mu * THIN * (l2 / l1 - 1 / (l1**3 * l2**3))
        sine = pressure_mpa * r / (2 * T1)
        cosine = np.sqrt(max(0.0, 1 - sine**2))
        return [l1 * cosine, -l1 * sine, T2 * l1 * cosine]

    def edge(pole):
        R0 = 1e-4
        start = [pole * R0, 0.0, tension(pole, pole) * pole * R0]
        return solve_ivp(slopes, (R0, RADIUS), start, rtol=1e-8, atol=1e-12).y[:, -1]

    taut = next(s for s in np.arange(1.01, 1.5, 0.01) if edge(s)[0] > RADIUS)
    pole = brentq(lambda stretch: edge(stretch)[0] - RADIUS, taut - 0.0099, taut)
    return -edge(pole)[1]


@pytest.mark.parametrize("pressure_mpa", [2e-5, 1e-4, 3e-4])
def test_inflated_circle_has_the_height_of_a_shell_of_revolution(pressure_mpa):
    at = inflated(1200, pressure_mpa)
    assert at.solution.outcome.converged
    height = at.solution.displacement_mm[:, 2].max()
    assert height == pytest.approx(height_by_shooting(pressure_mpa), rel=5e-3)


def test_slightly_inflated_circle_follows_hencky():
    """w = 0.595 a (p a / E t)^(1/3) for nu = 0.5 (H. Hencky, Z. Math. Phys. 63 (1915) 311)."""
    pressure = 1e-7
    height = inflated(1200, pressure).solution.displacement_mm[:, 2].max()
    expected = 0.595 * RADIUS * np.cbrt(pressure * RADIUS / (E * THIN))
    assert height == pytest.approx(expected, rel=5e-3)


def test_rim_carries_the_pressure():
    """The force on the rim along z is the pressure on the area of the hole."""
    at = inflated(800, 1e-4)
    area = CORNERS / 2 * RADIUS**2 * np.sin(2 * np.pi / CORNERS)
    assert -at.reactions[:, 2].sum() == pytest.approx(1e-4 * area, rel=1e-3)


def test_pressure_beyond_the_limit_has_no_equilibrium():
    """A neo-Hookean balloon bursts: an ordinary outcome with its reason."""
    outcome = inflated(300, 2e-3).solution.outcome
    assert not outcome.converged
    assert "no equilibrium beyond" in outcome.reason


# --- meshes ---
def test_mesh_fills_a_concave_outline_and_has_edges_along_borders():
    outline = np.array([[0, 0], [30, 0], [30, 10], [12, 10], [12, 30], [0, 30]], float)
    line = np.array([[4.0, -10.0], [4.0, 50.0]])
    found = sheet_mesh(outline, [line], 1000, 1.0)
    assert found.areas.sum() == pytest.approx(30 * 10 + 12 * 20, rel=1e-9)
    assert 700 < len(found.nodes) < 1400
    corners = found.nodes[found.triangles[:, :3], 0]
    assert not ((corners.min(axis=1) < 4 - 1e-6) & (corners.max(axis=1) > 4 + 1e-6)).any()
    places = np.random.default_rng(0).uniform([0, 0], [12, 30], (50, 2))
    points = np.column_stack([places, np.zeros(50)])
    x, y = found.nodes[:, 0], found.nodes[:, 1]
    at = found.at_points(points, 0.1)
    np.testing.assert_allclose(at @ (x * y + x**2), places.prod(axis=1) + places[:, 0] ** 2)
    with pytest.raises(InputError, match="outside the sheet"):
        found.at_points(np.array([[25.0, 25.0, 0.0]]), 3.0)


def test_uniform_load_is_shared_by_area_or_by_edge_length():
    found = sheet_mesh(RECTANGLE, [ACROSS], 300, THICKNESS)
    x = found.nodes[:, 0]
    whole = found.shares(np.ones(len(x), bool))
    assert whole @ x == pytest.approx(LENGTH / 2)
    end = found.shares(x > LENGTH - 1e-6)
    assert end.sum() == pytest.approx(1) and end @ found.nodes[:, 1] == pytest.approx(WIDTH / 2)
    corner = found.shares((x == 0) & (found.nodes[:, 1] == 0))
    assert np.count_nonzero(corner) == 1


def test_rejects_unsupported_problems(strip):
    with pytest.raises(InputError, match="cannot be simulated with a separate skin"):
        equilibrium(strip, pulled(1.1, membrane=Membrane(0.1, 1.0)))
    with pytest.raises(InputError, match="too coarse"):
        sheet_mesh(RECTANGLE, [], 20, THICKNESS)
    with pytest.raises(InputError, match="encloses no area"):
        sheet_mesh(RECTANGLE[[0, 2, 1, 3]], [], 300, THICKNESS)
    crossed = np.array([[0, 0], [30, 0], [10, 20], [20, -5]], float)
    with pytest.raises(InputError, match="does not cross itself"):
        sheet_mesh(crossed, [], 300, THICKNESS)


def test_sheet_without_support_has_no_equilibrium(strip):
    force = DeadForce((1e-3, 0, 0), side(0, LENGTH))
    outcome = equilibrium(strip, problem(Constants(E, 0.4), forces=(force,))).solution.outcome
    assert not outcome.converged
