"""Conjugate gradients for one, several and blocks of right-hand sides, and GMRES.

Vectors are in double precision, (n, 4) or (n, 4, LANES); see `sparse_products`.
The preconditioner may differ slightly from call to call (it rounds to single
precision), hence the Polak-Ribiere form, with ``r_new - r = -alpha A p``.

Right-hand sides in one block share their search directions: in each iteration every right-hand
side uses the directions of all (D. P. O'Leary, Linear Algebra Appl. 29 (1980) 293): a fifth to a
quarter fewer iterations than with its own alone, for some 200 lumps or attachments of a breast with
5000 nodes. Nearly dependent directions are dropped, because their products have no inverse.

GMRES is for a tangent that is not symmetric, preconditioned from the left. It minimises the
preconditioned residual, which estimates the error of the displacement (Saad and Schultz 1986). As
the preconditioner rounds to single precision, the residual is recomputed in double precision at
every restart.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.kernels_and_threads import CONTRACTED, Float32Array
from palpate.workers.mechanics.fem import sparse_products
from palpate.workers.mechanics.fem.simd_vectors import LANES, load, store

MAX_CG_ITERATIONS = 120
# A block costs slightly more than this many right-hand sides.
SOLVED_ONE_BY_ONE = 2


@dataclass(frozen=True, eq=False)
class Correction:
    """Solution of the linear system.

    Parameters
    ----------
    u : ndarray, shape (n, 3)
    iterations : int
    error : float
        Relative residual or relative error, as specified by the tolerance.
    negative : bool
        Whether a direction of negative curvature ended the iteration.
    curved : ndarray, shape (n, 3), optional
        That direction, downhill.
    """

    u: FloatArray
    iterations: int
    error: float
    negative: bool
    curved: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Corrections:
    """Solutions for several right-hand sides.

    Parameters
    ----------
    u : ndarray, shape (k, n, 3)
    iterations : ndarray of int, shape (k,)
    error : ndarray, shape (k,)
        Estimated relative error; larger than the tolerance if the iteration ended early.
    negative : bool
        Whether a direction of negative curvature was met: the tangent is not stable.
    """

    u: FloatArray
    iterations: NDArray[np.int64]
    error: FloatArray
    negative: bool


class Operator(Protocol):
    """Tangent that multiplies and preconditions vectors of either shape."""

    def multiply(self, x: FloatArray, y: FloatArray) -> None:
        """Set y to the tangent times x, and set the pressure of `x`."""

    def precondition(self, b: Float32Array) -> Float32Array:
        """Solve approximately."""


def solve_by_cg(
    operator: Operator, b: FloatArray, tolerance: float, *, by_error: bool = False
) -> Correction:
    """Solve for `b`, (n, 3), to a relative residual, or an error as in `solve_many_by_cg`."""
    r = np.zeros((len(b), 4))
    r[:, :3] = b
    x, p, y = np.zeros_like(r), np.zeros_like(r), np.zeros_like(r)
    single = r.astype(np.float32)
    norm = np.sqrt(sparse_products.dot(r, r))
    if norm == 0:
        return Correction(np.zeros_like(b), 0, 0.0, False)
    z = operator.precondition(single)
    rz, beta, error = sparse_products.dot(r, z), 0.0, 1.0
    for iteration in range(1, MAX_CG_ITERATIONS + 1):
        sparse_products.update_direction(beta, z, p)
        operator.multiply(p, y)
        curvature = sparse_products.dot(p, y)
        if curvature <= 0 or rz <= 0:
            curved = _displacement(p)
            u = curved if iteration == 1 else _displacement(x)
            return Correction(u, iteration, error, True, curved if rz > 0 else None)
        alpha = rz / curvature
        sparse_products.take_step(alpha, p, y, x, r)
        if not by_error:
            error = float(np.sqrt(sparse_products.dot(r, r)) / norm)
            if error < tolerance:
                return Correction(_displacement(x), iteration, error, False)
        single[:] = r
        z = operator.precondition(single)
        if by_error:
            error = float(np.sqrt(sparse_products.dot(z, z) / sparse_products.dot(x, x)))
            if error < tolerance:
                return Correction(_displacement(x), iteration, error, False)
        beta = -alpha * sparse_products.dot(y, z) / rz
        rz = sparse_products.dot(r, z)
    return Correction(_displacement(x), MAX_CG_ITERATIONS, error, False)


def solve_many_by_cg(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Solve for each of `b`, (k, n, 3), to a relative error, `LANES` at a time.

    The error is estimated by the preconditioned residual: the residual itself hardly
    reflects the displacement where a stiff plate takes most of the force.
    """
    whole = len(b) if len(b) % LANES > SOLVED_ONE_BY_ONE else len(b) - len(b) % LANES
    parts = [
        _solve_lanes(operator, b[k : min(k + LANES, whole)], tolerance)
        for k in range(0, whole, LANES)
    ]
    parts += [_solve_one_of_many(operator, right_side, tolerance) for right_side in b[whole:]]
    if not parts:
        return Corrections(np.zeros_like(b), np.zeros(0, np.int64), np.zeros(0), False)
    return Corrections(
        np.concatenate([part.u for part in parts]),
        np.concatenate([part.iterations for part in parts]),
        np.concatenate([part.error for part in parts]),
        any(part.negative for part in parts),
    )


def _solve_one_of_many(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Solve for one right-hand side, (n, 3), to a relative error."""
    solution = solve_by_cg(operator, b, tolerance, by_error=True)
    u = np.zeros_like(b) if solution.negative and solution.iterations == 1 else solution.u
    iterations, error = np.array([solution.iterations]), np.array([solution.error])
    return Corrections(u[None], iterations, error, solution.negative)


def _solve_lanes(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Solve for up to `LANES` right-hand sides; a finished lane does not change."""
    k = len(b)
    r = np.zeros((b.shape[1], 4, LANES))
    r[:, :3, :k] = np.moveaxis(b, 0, -1)
    x, p, y, z = (np.zeros_like(r) for _ in range(4))
    single = np.empty_like(r, dtype=np.float32)
    active = _dots(r, r) > 0
    error = active.astype(np.float64)
    iterations = np.zeros(LANES, np.int64)
    negative = False
    rz, alpha, beta = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for iteration in range(1, MAX_CG_ITERATIONS + 1):
        single[:] = r
        z[:] = operator.precondition(single)
        if iteration > 1:
            error[active] = np.sqrt(_divided(_dots(z, z), _dots(x, x), active))[active]
            active &= error >= tolerance
            if not active.any():
                break
            beta = -alpha * _divided(_dots(y, z), rz, active)
        rz = _dots(r, z)
        sparse_products.update_direction(beta, z, p)
        operator.multiply(p, y)
        curvature = _dots(p, y)
        unstable = active & ((curvature <= 0) | (rz <= 0))
        negative = negative or bool(unstable.any())
        active &= ~unstable
        alpha = _divided(rz, curvature, active)
        sparse_products.take_step(alpha, p, y, x, r)
        iterations[active] = iteration
    u = np.ascontiguousarray(np.moveaxis(x[:, :3, :k], -1, 0))
    return Corrections(u, iterations[:k], error[:k], negative)


def _displacement(x: FloatArray) -> FloatArray:
    """Return `x`, (n, 4), without its pressure."""
    return np.ascontiguousarray(x[:, :3])


def _dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the products of each lane of two blocks, shape (LANES,)."""
    sums = np.empty(LANES)
    sparse_products.dots(a, b, sums)
    return sums


def _divided(a: FloatArray, b: FloatArray, where: BoolArray) -> FloatArray:
    """Return a / b in the given lanes, zero in the others."""
    return np.divide(a, b, out=np.zeros_like(a), where=where)


# For curvatures along mixtures of directions, each direction scaled to a curvature of one.
LEAST_CURVATURE = 1e-10


def solve_many_by_block_cg(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Solve for each of `b`, (k, n, 3), to a relative error, in full blocks of `LANES`.

    The remainder, and blocks that meet negative curvature, are solved by
    `solve_many_by_cg`, which defines the error.
    """
    full = len(b) - len(b) % LANES
    parts = []
    for k in range(0, full, LANES):
        block = b[k : k + LANES]
        solved = _solve_shared_block(operator, block, tolerance)
        parts.append(solved or solve_many_by_cg(operator, block, tolerance))
    parts.append(solve_many_by_cg(operator, b[full:], tolerance))
    return Corrections(
        np.concatenate([part.u for part in parts]),
        np.concatenate([part.iterations for part in parts]),
        np.concatenate([part.error for part in parts]),
        any(part.negative for part in parts),
    )


def _solve_shared_block(operator: Operator, b: FloatArray, tolerance: float) -> Corrections | None:
    """Solve for `LANES` right-hand sides; None if a direction has negative curvature."""
    r = np.zeros((b.shape[1], 4, LANES))
    r[:, :3] = np.moveaxis(b, 0, -1)
    x, p, y, z = (np.zeros_like(r) for _ in range(4))
    single = np.empty_like(r, dtype=np.float32)
    error = (_lengths(r) > 0).astype(np.float64)
    iterations = np.zeros(LANES, np.int64)
    beta, inverse = np.zeros((2, LANES, LANES))
    for iteration in range(1, MAX_CG_ITERATIONS + 1):
        single[:] = r
        z[:] = operator.precondition(single)
        if iteration > 1:
            size = _lengths(x)
            error = np.divide(_lengths(z), size, out=np.zeros(LANES), where=size > 0)
            if (error < tolerance).all():
                break
            beta = -inverse @ _products(y, z)
        iterations[error >= tolerance] = iteration
        mix_directions(beta, z, p)
        operator.multiply(p, y)
        next_inverse = _inverse_curvature(_products(p, y))
        if next_inverse is None:
            return None
        inverse = next_inverse
        take_steps(inverse @ _products(p, r), p, y, x, r)
    u = np.ascontiguousarray(np.moveaxis(x[:, :3], -1, 0))
    return Corrections(u, iterations, error, False)


def _inverse_curvature(curvature: FloatArray) -> FloatArray | None:
    """Return the pseudo-inverse of p'Ap, (LANES, LANES); None if it is not positive."""
    diagonal = np.diagonal(curvature)
    if diagonal.min() < 0:
        return None
    scale = np.divide(1.0, np.sqrt(diagonal), out=np.zeros(LANES), where=diagonal > 0)
    values, vectors = np.linalg.eigh(scale[:, None] * (curvature + curvature.T) / 2 * scale)
    if values[0] < -np.sqrt(LEAST_CURVATURE):
        return None
    kept = values > LEAST_CURVATURE
    half = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(half @ half.T)


def _lengths(a: FloatArray) -> FloatArray:
    """Return the length of each lane of a block, shape (LANES,)."""
    sums = np.empty(LANES)
    sparse_products.dots(a, a, sums)
    return np.sqrt(sums)


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the products of each lane of `a` with each of `b`, shape (LANES, LANES)."""
    sums = np.zeros((LANES, LANES))
    add_products(a, b, sums)
    return sums


@njit(**CONTRACTED)
def add_products(a: FloatArray, b: FloatArray, sums: FloatArray) -> None:
    """Add a' b of two blocks, (n, 4, LANES), without their pressures to `sums`."""
    for i in range(a.shape[0]):
        for c in range(3):
            right = load(b, 4 * i + c)
            for k in range(LANES):
                store(sums, k, load(sums, k) + a[i, c, k] * right)


@njit(**CONTRACTED)
def take_steps(
    alpha: FloatArray, p: FloatArray, y: FloatArray, x: FloatArray, r: FloatArray
) -> None:
    """Add p alpha to `x` and subtract y alpha from `r`; `alpha` is (LANES, LANES)."""
    for i in range(x.shape[0]):
        for c in range(3):
            there, left = load(x, 4 * i + c), load(r, 4 * i + c)
            for k in range(LANES):
                step = load(alpha, k)
                there = there + p[i, c, k] * step
                left = left - y[i, c, k] * step
            store(x, 4 * i + c, there)
            store(r, 4 * i + c, left)


@njit(**CONTRACTED)
def mix_directions(beta: FloatArray, z: FloatArray, p: FloatArray) -> None:
    """Set p = z + p beta; `beta` is (LANES, LANES)."""
    for i in range(p.shape[0]):
        for c in range(3):
            mixed = load(z, 4 * i + c)
            for k in range(LANES):
                mixed = mixed + p[i, c, k] * load(beta, k)
            store(p, 4 * i + c, mixed)


# Directions kept, and number of restarts.
GMRES_DIRECTIONS, GMRES_RESTARTS = 30, 8
# Reduction of a residual before it is recomputed; beyond it, rounding of the preconditioner
# would dominate.
DEEPEST_REDUCTION = 1e-5

LinearMap = Callable[[FloatArray], FloatArray]
"""Linear map of vectors of shape (n, 4), whose last component is zero."""


def solve_by_gmres(
    multiply: LinearMap, precondition: LinearMap, b: FloatArray, tolerance: float
) -> Correction:
    """Solve for `b`, shape (n, 3), to an estimated relative error of the displacement.

    Parameters
    ----------
    multiply, precondition : Product
        The tangent, and an approximation of its inverse.
    b : ndarray, shape (n, 3)
    tolerance : float

    Returns
    -------
    Correction
        `error` is larger than `tolerance` if the iteration ended early; `negative` is False.
    """
    residual = np.zeros((len(b), 4))
    residual[:, :3] = b
    x = np.zeros_like(residual)
    iterations, first, error = 0, 0.0, 0.0
    for restart in range(GMRES_RESTARTS):
        z = precondition(residual)
        size = float(np.linalg.norm(z))
        first = size if restart == 0 else first
        error = size / first if first > 0 else 0.0
        if error <= tolerance:
            break
        goal = max(tolerance * first, DEEPEST_REDUCTION * size)
        step, used, left = _gmres_cycle(multiply, precondition, z, goal)
        x += step
        iterations, error = iterations + used, left / first
        if error <= tolerance:
            break
        residual[:, :3] = b
        residual -= multiply(x)
    return Correction(np.ascontiguousarray(x[:, :3]), iterations, error, False)


def _gmres_cycle(
    multiply: LinearMap, precondition: LinearMap, z: FloatArray, goal: float
) -> tuple[FloatArray, int, float]:
    """Return a correction for the residual `z`, the number of directions, and the residual left.

    Arnoldi's method with two passes of Gram-Schmidt; the least-squares problem of the Hessenberg
    matrix is small enough to solve afresh each time.
    """
    basis = np.empty((GMRES_DIRECTIONS + 1, z.size))
    hessenberg = np.zeros((GMRES_DIRECTIONS + 1, GMRES_DIRECTIONS))
    size = float(np.linalg.norm(z))
    basis[0] = z.ravel() / size
    target = np.zeros(GMRES_DIRECTIONS + 1)
    target[0] = size
    for k in range(GMRES_DIRECTIONS):
        w = precondition(multiply(basis[k].reshape(z.shape))).ravel()
        so_far = basis[: k + 1]
        for _ in range(2):
            along = so_far @ w
            w -= along @ so_far
            hessenberg[: k + 1, k] += along
        length = float(np.linalg.norm(w))
        hessenberg[k + 1, k] = length
        part = hessenberg[: k + 2, : k + 1]
        weights = np.linalg.lstsq(part, target[: k + 2], rcond=None)[0]
        left = float(np.linalg.norm(target[: k + 2] - part @ weights))
        if left <= goal or length <= 1e-14 * size:
            break
        basis[k + 1] = w / length
    return (weights @ so_far).reshape(z.shape), k + 1, left
