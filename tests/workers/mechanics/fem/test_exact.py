"""Bodies with closed-form solutions."""

import numpy as np
import pytest
from scipy.optimize import fsolve

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import (
    Constants,
    FibreField,
    Membrane,
    Problem,
)
from palpate.workers.mechanics.fem.discretisation import State
from palpate.workers.mechanics.fem.energy_minimisation import minimise
from palpate.workers.mechanics.fem.loads_and_regions import DistanceControl, ForceControl
from palpate.workers.mechanics.fem.multigrid import solver_factory
from tests.workers.mechanics.fem.blocks import OPEN, cube, holding, loose_level, model_of


def uniaxial(c: Constants, stretch_y: float, *, fibre: float = 1.0) -> tuple[float, float, float]:
    """Return nominal stress along y and stretches along x and z: free sides, fibres along z.

    With lambda = (lx, ly, lz), J = lx ly lz, I1 = sum lambda^2:
    P_i = mu J^-2/3 (l_i - I1 / (3 l_i)) + kappa (J - 1) J / l_i
          + [i = z] 2 eta (lz^2 - 1) lz,  and P_x = P_z = 0.
    """

    def nominal(lx, lz):
        stretch = np.array([lx, stretch_y, lz])
        J, I1 = stretch.prod(), (stretch**2).sum()
        P = c.mu_mpa * J ** (-2 / 3) * (stretch - I1 / 3 / stretch)
        P += c.kappa_mpa * (J - 1) * J / stretch
        P[2] += fibre * 2 * c.fibre_mpa * (lz**2 - 1) * lz
        return P

    lx, lz = fsolve(lambda s: nominal(*s)[[0, 2]], [stretch_y**-0.5, 1.01], xtol=1e-13)
    return float(nominal(lx, lz)[1]), float(lx), float(lz)


@pytest.mark.parametrize("plain", [False, True])
def test_affine_boundary_gives_an_affine_interior(plain):
    """With an affine boundary the interior is affine, whatever the mesh."""
    model = model_of(cube(4, jitter=0.25)).finest
    level = loose_level(model, Constants(0.01, 0.49, 0.1), plain_elements=plain)
    F = np.array([[1.2, 0.1, 0.0], [0.05, 0.9, 0.1], [0.0, -0.05, 1.05]])
    exact = model.nodes @ F.T
    inner = ((model.nodes > 1e-9) & (model.nodes < 10 - 1e-9)).all(axis=1)
    level = holding(level, ~inner)
    start = exact + inner[:, None] * np.random.default_rng(1).uniform(-0.3, 0.3, exact.shape)
    result = minimise(level, State(start, 0.0), OPEN, solver_factory(()), 1e-7)
    assert result.reason == ""
    np.testing.assert_allclose(result.state.x, exact, atol=1e-8)


@pytest.mark.parametrize("eta", [0.0, 0.1])
def test_uniaxial_compression_with_fibres_matches_the_closed_form(eta):
    model = model_of(cube(3, jitter=0.2)).finest
    c = Constants(0.01, 0.49, eta)
    level = loose_level(model, c)
    X = model.nodes
    held = X < 1e-9
    top = X[:, 1] > 10 - 1e-9
    held[top, 1] = True
    level = holding(level, held)
    result = minimise(level, State(X * [1.2, 0.7, 1.02], 0.0), OPEN, solver_factory(()), 1e-8)
    assert result.reason == ""
    stress, lx, lz = uniaxial(c, 0.7)
    np.testing.assert_allclose(result.state.x, X * [lx, 0.7, lz], atol=1e-6)
    force = level.force(result.state, level.energy(result.state, OPEN), OPEN)
    assert force[top, 1].sum() == pytest.approx(100 * stress, rel=1e-7)


def test_fibres_in_tension_only_do_not_resist_compression():
    """Compressed along its fibres, only the matrix acts; with literal fibres it is stiffer."""
    model = model_of(cube(2))
    c = Constants(0.01, 0.49, 0.002)
    load = DistanceControl(0.0, 9.9)
    forces = {}
    for name, options in {
        "matrix": {"constants": {Tissue.FAT: Constants(0.01, 0.49)}},
        "tension": {"constants": {Tissue.FAT: c}, "fibres": FibreField((0.0, 1.0, 0.0))},
        "literal": {
            "constants": {Tissue.FAT: c},
            "fibres": FibreField((0.0, 1.0, 0.0)),
            "literal_fibre": True,
        },
    }.items():
        forces[name] = solve(model, Problem(load=load, **options)).outcome.plate_force_n
    assert forces["tension"] == pytest.approx(forces["matrix"], rel=1e-6)
    # Small strains: the fibre adds 4 eta to Young's modulus.
    assert forces["literal"] / forces["matrix"] == pytest.approx(1.8, rel=0.03)


def test_block_between_frictionless_plates_is_in_uniaxial_stress():
    """Uniaxial stress; the plates penetrate by pressure / 0.5 N/mm^3."""
    c = Constants(0.01, 0.49, 0.02)
    mesh = cube(4)
    solution = solve(model_of(mesh), Problem({Tissue.FAT: c}, DistanceControl(0.0, 8.0)))
    outcome = solution.outcome
    assert outcome.converged, outcome.reason
    y, u = mesh.nodes[:, 1], solution.displacement_mm[:, 1]
    stretch = 1 + (u[y > 9.99].mean() - u[y < 0.01].mean()) / 10
    assert stretch == pytest.approx(0.8, abs=0.003)
    stress, _, lz = uniaxial(c, stretch)
    assert outcome.plate_force_n == pytest.approx(-100 * stress, rel=1e-3)
    assert outcome.force_imbalance < 1e-6
    assert abs(outcome.wall_force_n) < 1e-5
    assert solution.displacement_mm[:, 2].max() == pytest.approx(10 * (lz - 1), rel=0.05)


def test_force_control_inverts_distance_control():
    model = model_of(cube(4))
    c = {Tissue.FAT: Constants(0.01, 0.49, 0.02)}
    prescribed = solve(model, Problem(c, DistanceControl(0.0, 8.0), tolerance_mm=1e-6))
    force_n = prescribed.outcome.plate_force_n
    found = solve(model, Problem(c, ForceControl(force_n, 0.0, 10.0), tolerance_mm=1e-6))
    assert found.outcome.converged
    assert found.outcome.plate_force_n == pytest.approx(force_n, rel=1e-9)
    assert found.outcome.plate_displacement_mm == pytest.approx(2.0, abs=1e-5)


def test_skin_stiffens_the_body():
    model = model_of(cube(3))
    c = {Tissue.FAT: Constants(0.01, 0.49)}
    load = DistanceControl(0.0, 8.0)
    bare = solve(model, Problem(c, load)).outcome.plate_force_n
    covered = solve(model, Problem(c, load, membrane=Membrane(0.1, 1.0))).outcome
    assert covered.converged
    assert covered.plate_force_n > 1.5 * bare


def test_multigrid_agrees_with_the_direct_solver():
    c = {Tissue.FAT: Constants(0.01, 0.49, 0.05)}
    problem = Problem(c, ForceControl(0.3, 0.0, 10.0), tolerance_mm=1e-6)
    fine = cube(6, jitter=0.15)
    direct = solve(model_of(fine), problem)
    nested = solve(model_of(cube(3), fine), problem)
    assert direct.outcome.converged
    assert nested.outcome.converged
    np.testing.assert_allclose(nested.displacement_mm, direct.displacement_mm, atol=1e-5)
    assert nested.outcome.cg_iterations[-1] < 30 * nested.outcome.newton_iterations[-1]


def test_repeated_solves_are_bit_identical():
    model = model_of(cube(2), cube(4, jitter=0.2))
    problem = Problem({Tissue.FAT: Constants(0.01, 0.49, 0.05)}, ForceControl(0.3, 0.0, 10.0))
    first, second = solve(model, problem), solve(model, problem)
    assert np.array_equal(first.displacement_mm, second.displacement_mm)
    assert first.outcome == second.outcome


def test_divergence_is_an_outcome_with_a_reason():
    """No body withstands a million newtons."""
    problem = Problem({Tissue.FAT: Constants(0.01, 0.49)}, ForceControl(1e6, 0.0, 10.0))
    outcome = solve(model_of(cube(2)), problem).outcome
    assert not outcome.converged
    assert "plates met" in outcome.reason
