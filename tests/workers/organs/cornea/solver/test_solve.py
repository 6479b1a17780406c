"""Properties of every solution, support at the limbus, and possible outcomes."""

import time

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.cornea_equations import follow, system_of
from palpate.workers.organs.cornea.cornea_problem import prepare, stiffness_factors
from palpate.workers.organs.cornea.corneal_model import (
    MPA_PER_MMHG,
    CorneaConstants,
    CorneaLoad,
    CorneaModel,
    JetProfile,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import prestressed, solve_prepared
from palpate.workers.organs.cornea.section_mesh import T6Mesh
from tests.workers.organs.cornea.solver.solved import solve_cornea
from tests.workers.organs.cornea.solver.structured_t6 import corneal_arc

IOP = 10.5 * MPA_PER_MMHG
X1 = CorneaConstants((0.011, 0.035), (30.0, 80.0))
X2 = CorneaConstants((0.036, 0.0325), (50.0, 88.0))
MESH = corneal_arc(60, 2)


def solved(constants=X1, load=None, mesh=MESH, **options):
    solution = solve_cornea(mesh, constants, load or CorneaLoad(IOP), CorneaModel(**options))
    assert solution.converged, solution.reason
    assert solution.stable
    return solution


@pytest.mark.parametrize("method", ["additive", "mulf", "inverse", "none"])
def test_swapping_the_two_ogden_terms_changes_nothing(method):
    swapped = CorneaConstants(X1.mu_mpa[::-1], X1.alpha[::-1])
    u, v = (solved(c, prestress=method).displacement_mm for c in (X1, swapped))
    np.testing.assert_allclose(u, v, atol=1e-9)


@pytest.mark.parametrize("kind", ["plane stress", "plane strain", "axisymmetric"])
def test_a_symmetric_cornea_deforms_symmetrically(kind):
    u = solved(kind=kind).displacement_mm
    line = MESH.anterior
    np.testing.assert_allclose(u[line, 0], -u[line[::-1], 0], atol=1e-6)
    np.testing.assert_allclose(u[line, 1], u[line[::-1], 1], atol=1e-6)


def test_solution_is_independent_of_the_load_path():
    """In one step, or in many small steps."""
    prepared = prepare(MESH, CorneaModel())
    rest = prestressed(system_of(prepared, X1, CorneaLoad(IOP)))
    system = rest.system
    path = follow(system, rest.u, system.image_stage, system.jet_stage, first_step=0.05)
    assert path.steps >= 5
    at_once = solve_prepared(prepared, X1, CorneaLoad(IOP))
    np.testing.assert_allclose(path.u, at_once.displacement_mm, atol=1e-6)


def test_displacement_is_in_equilibrium_for_every_prestress():
    """A simulation is repeated to rounding accuracy, with a full Newton step at its end."""
    for method in ("additive", "mulf", "inverse"):
        prepared = prepare(MESH, CorneaModel(prestress=method))
        rest = prestressed(system_of(prepared, X1, CorneaLoad(IOP)))
        u = solve_prepared(prepared, X1, CorneaLoad(IOP)).displacement_mm
        residual, _, factors = rest.system.linearise(u, rest.system.jet_stage)
        assert np.abs(factors.solve(residual)).max() < 1e-7


@pytest.mark.parametrize("limbus", [None, 0.5])
def test_a_cornea_moves_with_the_eye_as_a_rigid_body(limbus):
    """Without pressures, a shift and a tilt of the limbus leave no strain."""
    load = CorneaLoad(0.0, 0.0, eye_shift_mm=(0.1, -0.3), eye_tilt_rad=0.15)
    solution = solved(load=load, limbus_mpa_per_mm=limbus)
    limbus_nodes = np.unique(np.concatenate([MESH.left, MESH.right]))
    centre = MESH.nodes_mm[limbus_nodes].mean(axis=0)
    c, s = np.cos(0.15), np.sin(0.15)
    expected = (MESH.nodes_mm - centre) @ np.array([[c, s], [-s, c]]) + centre + (0.1, -0.3)
    np.testing.assert_allclose(MESH.nodes_mm + solution.displacement_mm, expected, atol=1e-6)
    assert solution.min_j == pytest.approx(1, abs=1e-6)


def test_eye_shift_adds_to_the_effect_of_the_jet():
    """The jet follows the cornea, so a translation is added unchanged."""
    still = solved()
    moved = solved(load=CorneaLoad(IOP, eye_shift_mm=(0.2, -0.25)))
    np.testing.assert_allclose(
        moved.displacement_mm, still.displacement_mm + np.array([0.2, -0.25]), atol=1e-6
    )


def test_elastic_limbus_is_between_free_and_clamped():
    clamped = solved().apex_displacement_um
    soft, stiff, stiffest = (
        solved(limbus_mpa_per_mm=k).apex_displacement_um for k in (1.0, 10.0, 1e5)
    )
    assert soft > stiff > clamped
    assert stiffest == pytest.approx(clamped, rel=1e-4)


def test_the_elastic_limbus_carries_the_load():
    """Springs and pressures balance: the sum of the reactions equals the force of the jet."""
    prepared = prepare(MESH, CorneaModel(limbus_mpa_per_mm=0.5, prestress="none"))
    load = CorneaLoad(0.0)
    u = solve_prepared(prepared, X1, load).displacement_mm
    limbus = prepared.limbus
    reaction = 0.5 * (limbus.mass @ u[limbus.nodes]).sum(axis=0)
    x = MESH.nodes_mm + u
    jet = system_of(prepared, X1, load).jet
    tangent = np.einsum("kn,kni->ki", jet.slope, x[jet.nodes])
    force = (jet.weights[:, None] * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)).sum(axis=0)
    np.testing.assert_allclose(reaction, load.jet_pressure_mpa * force, atol=1e-8)


def test_apex_moves_towards_the_softer_side():
    """A gradient to the right makes the left half softer, and vice versa."""
    apex = MESH.anterior[60]
    right, left = (solved(side_gradient=g).displacement_mm for g in (0.5, -0.5))
    assert right[apex, 0] < -0.01
    np.testing.assert_allclose(right[MESH.anterior, 0], -left[MESH.anterior[::-1], 0], atol=1e-6)
    np.testing.assert_allclose(right[MESH.anterior, 1], left[MESH.anterior[::-1], 1], atol=1e-6)


def test_a_gradient_stiffens_the_posterior_and_the_right():
    """By exp(g/2) at the surfaces; the centroids are a sixth of a cell inside."""
    depth = np.log(stiffness_factors(MESH, CorneaModel(depth_gradient=2.0))) / 2
    side = np.log(stiffness_factors(MESH, CorneaModel(side_gradient=2.0))) / 2
    centres = MESH.nodes_mm[MESH.triangles[:, :3]].mean(axis=1)
    outer = np.linalg.norm(centres, axis=1) > 7.7
    assert outer.any()
    assert (depth[outer] < -0.3).all()
    assert np.abs(depth).max() < 0.5
    assert depth.mean() == pytest.approx(0, abs=0.02)
    np.testing.assert_allclose(side, centres[:, 0] / 11.7, atol=1e-12)


def test_off_centre_jet_dents_the_cornea_off_centre():
    solution = solved(load=CorneaLoad(IOP, jet_centre_mm=0.5))
    deepest = MESH.anterior[np.argmin(solution.displacement_mm[MESH.anterior, 1])]
    assert 0.2 < MESH.nodes_mm[deepest, 0] < 0.8


def test_single_point_profile_equals_a_uniform_jet():
    uniform = solved().displacement_mm
    profile = solved(load=CorneaLoad(IOP, jet_profile=JetProfile((1.5,), (1.0,))))
    np.testing.assert_allclose(profile.displacement_mm, uniform, atol=1e-9)


def test_snap_through_converges_to_a_stable_state():
    """Thin and soft: twice the jet moves the apex more than three times as far, past the chord."""
    soft = CorneaConstants((0.008, 0.02), (30.0, 60.0))
    solution = solved(soft, mesh=corneal_arc(120, 4))
    assert solution.apex_displacement_um > 2500
    half = solved(soft, CorneaLoad(IOP, 0.0075), corneal_arc(120, 4))
    assert half.apex_displacement_um < solution.apex_displacement_um / 3


def test_crushing_jet_is_an_ordinary_outcome():
    weak = CorneaConstants((1e-4,), (2.0,), bulk_mpa=1e-3)
    solution = solve_cornea(MESH, weak, CorneaLoad(0.0, 0.5), CorneaModel())
    assert not solution.converged
    assert "of the jet" in solution.reason
    assert 0 <= solution.jet_fraction < 1
    assert np.isfinite(solution.displacement_mm).all()


@pytest.mark.parametrize("constants", [X1, X2])
def test_solution_takes_a_quarter_of_a_second(constants):
    """For 960 triangles, prestress and jet; thread time, the best of five."""
    prepared = prepare(corneal_arc(120, 4), CorneaModel())
    times = []
    for _ in range(5):
        start = time.thread_time()
        solution = solve_prepared(prepared, constants, CorneaLoad(IOP))
        times.append(time.thread_time() - start)
    assert solution.converged
    assert solution.newton_iterations <= 30
    assert solution.factorisations <= 15
    assert min(times) < 0.25


def test_rejects_a_mesh_across_the_axis():
    with pytest.raises(InputError, match="extend across its axis"):
        prepare(corneal_arc(61, 2), CorneaModel(kind="axisymmetric"))


def test_rejects_crossing_surfaces():
    thin = corneal_arc(20, 2, thickness_mm=(-0.1, 0.7))
    with pytest.raises(InputError, match="is inverted"):
        prepare(thin, CorneaModel())


def test_rejects_a_mesh_without_a_limbus():
    nothing = np.empty(0, dtype=np.int32)
    bare = T6Mesh(MESH.nodes_mm, MESH.triangles, MESH.anterior, MESH.posterior, nothing, nothing)
    with pytest.raises(InputError, match="no limbus nodes"):
        prepare(bare, CorneaModel())


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"kind": "solid"}, "kind of section"),
        ({"prestress": "sellier"}, "prestress of a corneal model"),
        ({"quadrature_points": 4}, "quadrature points"),
        ({"limbus_mpa_per_mm": 0.0}, "positive stiffness"),
        ({"tolerance_mm": 0.0}, "must be positive"),
    ],
)
def test_rejects_invalid_models(bad, message):
    with pytest.raises(InputError, match=message):
        CorneaModel(**bad)
