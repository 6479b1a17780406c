"""Linear solvers against dense matrices."""

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem import krylov_solvers
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.discretisation import Stage, State
from palpate.workers.mechanics.fem.loads_and_regions import Device, ForceControl, Plate, Wall
from palpate.workers.mechanics.fem.mesh_level import Level, Tangent
from palpate.workers.mechanics.fem.multigrid import (
    DEGREE,
    RATIO,
    CholeskySolver,
    Multigrid,
    PackedTangent,
    dense_matrix,
)
from palpate.workers.mechanics.fem.plate_surface import Gap
from palpate.workers.mechanics.fem.simd_vectors import LANES
from tests.workers.mechanics.fem.blocks import cube, model_of

TILTED = Device(pivot_mm=(5, 5, 5), upper=Plate(tilt_deg=(6.0, -4.0)))
# Held along x and z at the wall: a body free to drift along x has a large displacement under a
# small load, and the comparison would be limited by single precision.
PROBLEM = Problem(
    {Tissue.FAT: Constants(0.01, 0.49, 0.05)},
    ForceControl(0.3, 0.3, 9.5, TILTED),
    wall=Wall((True, False, True)),
)
STAGE = Stage(Gap(0.3, 9.5), 0.3, 1.0, TILTED)


@pytest.fixture(scope="module")
def levels() -> list[Level]:
    return [Level.build(m, PROBLEM) for m in model_of(cube(2), cube(4), cube(8, jitter=0.15))]


def tangent_of(level: Level) -> Tangent:
    """Return the tangent of a body slightly squeezed between tilted plates."""
    X = level.model.nodes
    state = State(level.with_prescribed(X * [1.02, 0.98, 1.01] + 0.02 * np.sin(X), 1.0), 0.1)
    return level.linearise(state, level.energy(state, STAGE), STAGE)[1]


def dense_of(level: Level, t: Tangent) -> np.ndarray:
    """Return K + B D B^T - c c^T / s, 1 on the diagonal where held."""
    g = level.model.graph
    A = dense_matrix(g.start, g.neighbour, t.rows, level.free)
    c = np.zeros(level.free.shape)
    c[t.contact_index] = t.coupling
    assert np.count_nonzero(np.abs(c).sum(axis=0)) == 3  # the plate pushes in every direction
    return A - np.outer(c, c) / t.plate_stiffness


def loads_on(level: Level, k: int) -> np.ndarray:
    """Return right-hand sides of very different sizes, shape (k, n, 3)."""
    rng = np.random.default_rng(k)
    b = rng.standard_normal((k, *level.free.shape)) * level.free
    return b * 10.0 ** rng.uniform(-4, 4, (k, 1, 1))


def multigrid_of(levels: list[Level]) -> Multigrid:
    solver = CholeskySolver(levels[0], tangent_of(levels[0]))
    for level in levels[1:]:
        solver = Multigrid(level, tangent_of(level), solver)
    return solver


def four(x: np.ndarray, dtype: type) -> np.ndarray:
    """Pad (n, 3) or (n, 3, k) by a pressure and to all lanes."""
    shape = (len(x), 4) if x.ndim == 2 else (len(x), 4, LANES)
    out = np.zeros(shape, dtype)
    out[(slice(None), slice(0, 3), *(slice(0, k) for k in x.shape[2:]))] = x
    return out


@pytest.mark.parametrize(("dtype", "rounding"), [(np.float64, 1e-6), (np.float32, 3e-6)])
def test_packed_rows_multiply_like_the_dense_tangent(levels, dtype, rounding):
    level = levels[1]
    t = tangent_of(level)
    packed, A = PackedTangent(level, t), dense_of(level, t)
    x = np.random.default_rng(1).standard_normal((*level.free.shape, 5)) * level.free[..., None]
    exact = (A @ x.reshape(-1, 5)).reshape(x.shape)
    one, block = four(x[..., 2], dtype), four(x, dtype)
    y_one, y_block = np.zeros_like(one), np.zeros_like(block)
    packed.multiply(one, y_one)
    packed.multiply(block, y_block)
    atol = rounding * np.abs(exact).max()
    np.testing.assert_allclose(y_one[:, :3], exact[..., 2], rtol=0, atol=atol)
    np.testing.assert_allclose(y_block[:, :3, :5], exact, rtol=0, atol=atol)
    assert not y_block[:, :3, 5:].any()


def test_smoothing_is_the_chebyshev_polynomial(levels):
    """From zero, the error after smoothing is T_d((c - DA)/h) / T_d(c/h) times the error before.

    T_d is the Chebyshev polynomial, c and h centre and half width of the interval.
    """
    level, t = levels[1], tangent_of(levels[1])
    solver = Multigrid(level, t, CholeskySolver(levels[0], tangent_of(levels[0])))
    A, n = dense_of(level, t), level.free.size
    free = np.flatnonzero(level.free.ravel())
    b = loads_on(level, 1)[0]
    b /= np.abs(b).max()
    r, step = four(b, np.float32), np.zeros((len(b), 4), np.float32)
    packed, steps = solver._packed, solver._steps
    packed.first_step(steps[0][1], r, step)
    x, other = step.copy(), np.zeros_like(step)
    for keep, scale in steps[1:]:
        packed.smoothing_sweep(keep, scale, r, x, step, other)
        step, other = other, step

    jacobi = np.zeros((n, n))
    for i, block in enumerate(packed._inverse.reshape(-1, 3, 3)):
        jacobi[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    DA = (jacobi @ A)[np.ix_(free, free)]
    centre = 1 / float(steps[0][1])
    half = centre * (RATIO - 1) / (RATIO + 1)
    argument = (centre * np.eye(len(free)) - DA) / half
    before, now = np.eye(len(free)), argument
    for _ in range(DEGREE - 1):
        before, now = now, 2 * argument @ now - before
    exact = np.linalg.solve(A, b.ravel())[free]
    error = now @ exact / np.cosh(DEGREE * np.arccosh(centre / half))
    np.testing.assert_allclose(
        x[:, :3].ravel()[free], exact - error, atol=1e-4 * np.abs(exact).max()
    )
    # The interval must cover the spectrum, or the smoother amplifies.
    assert np.linalg.eigvals(DA).real.max() < centre + half


def test_v_cycle_is_symmetric_and_positive(levels):
    solver = multigrid_of(levels)
    a, b = (x / np.abs(x).max() for x in loads_on(levels[-1], 2))
    cycled = [solver.precondition(four(x, np.float32))[:, :3].astype(float) for x in (a, b)]
    scale = np.linalg.norm(cycled[0]) * np.linalg.norm(b)
    assert abs(np.vdot(cycled[0], b) - np.vdot(a, cycled[1])) < 1e-5 * scale
    assert np.vdot(a, cycled[0]) > 0
    assert not (cycled[0] * (1 - levels[-1].free)).any()


def test_v_cycle_of_a_block_equals_each_column(levels):
    solver = multigrid_of(levels)
    b = np.moveaxis(loads_on(levels[-1], 3), 0, -1)
    b /= np.abs(b).max(axis=(0, 1))
    block = solver.precondition(four(b, np.float32))[:, :3].copy()
    for k in range(3):
        alone = solver.precondition(four(b[..., k], np.float32))[:, :3]
        np.testing.assert_allclose(block[..., k], alone, atol=1e-4 * np.abs(alone).max())


@pytest.mark.parametrize("kind", ["factored", "multigrid"])
@pytest.mark.parametrize("k", [1, 5, LANES + 3])
def test_blocks_are_solved_like_by_a_dense_solver(levels, kind, k):
    level = levels[-1]
    t = tangent_of(level)
    solver = CholeskySolver(level, t) if kind == "factored" else multigrid_of(levels)
    A, b = dense_of(level, t), loads_on(level, k)
    b[k // 2] = 0
    many = solver.solve_many(b, 1e-9)
    exact = np.linalg.solve(A, b.reshape(k, -1).T).T.reshape(b.shape)
    for u, answer in zip(many.u, exact, strict=True):
        np.testing.assert_allclose(u, answer, rtol=0, atol=1e-6 * max(np.abs(answer).max(), 1e-30))
    left = np.einsum("ij,kj->ki", A, many.u.reshape(k, -1)) - b.reshape(k, -1)
    norm = np.linalg.norm(b.reshape(k, -1), axis=1)
    # The matrix of the product is stored in single precision.
    assert (np.linalg.norm(left, axis=1) <= 2e-6 * norm).all()
    assert (many.error < 1e-9).all()
    assert not many.negative
    assert not many.u[k // 2].any()


def test_block_solution_equals_single_solutions(levels):
    solver, b = multigrid_of(levels), loads_on(levels[-1], 4)
    many = solver.solve_many(b, 1e-8)
    for k in range(4):
        alone = krylov_solvers.solve_by_cg(solver, b[k], 1e-8, by_error=True)
        assert abs(alone.iterations - many.iterations[k]) <= 1
        np.testing.assert_allclose(many.u[k], alone.u, rtol=0, atol=1e-6 * np.abs(alone.u).max())


def test_block_needs_fewer_iterations_than_single_solves(levels):
    solver, b = multigrid_of(levels), loads_on(levels[-1], LANES)
    together = krylov_solvers.solve_many_by_block_cg(solver, b, 1e-6)
    alone = krylov_solvers.solve_many_by_cg(solver, b, 1e-6)
    assert together.iterations.max() < alone.iterations.max()
    for one, other in zip(together.u, alone.u, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-4 * np.abs(other).max())


def test_solves_a_block_of_similar_right_hand_sides(levels):
    solver, b = multigrid_of(levels), loads_on(levels[-1], 2)
    alike = np.concatenate([b, b, b, -2 * b])
    many = krylov_solvers.solve_many_by_block_cg(solver, alike, 1e-6)
    alone = krylov_solvers.solve_many_by_cg(solver, b, 1e-6)
    assert (many.error < 1e-6).all()
    for k, share in enumerate((1, 1, 1, -2)):
        near = np.abs(alone.u).max() * 1e-4
        np.testing.assert_allclose(many.u[2 * k : 2 * k + 2], share * alone.u, rtol=0, atol=near)


def test_solves_zero_right_hand_sides(levels):
    for solver in (multigrid_of(levels), CholeskySolver(levels[0], tangent_of(levels[0]))):
        n = len(levels[-1].free) if isinstance(solver, Multigrid) else len(levels[0].free)
        many = solver.solve_many(np.zeros((0, n, 3)), 1e-6)
        assert many.u.shape == (0, n, 3)
        assert many.error.shape == (0,)


def test_iterations_grow_little_with_the_mesh(levels):
    b = [loads_on(level, 1)[0] for level in levels]
    few = multigrid_of(levels[:2]).solve(b[1], 1e-8).iterations
    more = multigrid_of(levels).solve(b[2], 1e-8).iterations
    assert more < 2 * few
    assert more < 60


def test_reports_negative_curvature(levels):
    level = levels[1]
    t = tangent_of(level)
    negative = -t.rows
    negative[:, 3::4] = 0
    upside_down = Tangent(negative, t.contact_index, 0 * t.coupling, 0.0)
    solver = Multigrid(level, upside_down, CholeskySolver(levels[0], tangent_of(levels[0])))
    b = loads_on(level, 2)
    assert solver.solve(b[0], 1e-6).negative
    assert solver.solve_many(b, 1e-6).negative
    assert solver.solve_many(loads_on(level, LANES), 1e-6).negative
