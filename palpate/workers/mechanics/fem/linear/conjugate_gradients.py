"""Conjugate gradients for one right-hand side and for several solved together.

Vectors are in double precision, (n, 4) or (n, 4, LANES); see `sparse_products`.
The preconditioner may differ slightly from call to call (it rounds to single
precision), hence the Polak-Ribiere form, with ``r_new - r = -alpha A p``.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.mechanics.fem.elements.simd import LANES
from palpate.workers.mechanics.fem.linear import sparse_products
from palpate.workers.mechanics.fem.problem.array_types import Float32Array

MAX_ITERATIONS = 120
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


def solve(
    operator: Operator, b: FloatArray, tolerance: float, *, by_error: bool = False
) -> Correction:
    """Solve for `b`, (n, 3), to a relative residual, or a relative error as in `solve_many`."""
    r = np.zeros((len(b), 4))
    r[:, :3] = b
    x, p, y = np.zeros_like(r), np.zeros_like(r), np.zeros_like(r)
    single = r.astype(np.float32)
    norm = np.sqrt(sparse_products.dot(r, r))
    if norm == 0:
        return Correction(np.zeros_like(b), 0, 0.0, False)
    z = operator.precondition(single)
    rz, beta, error = sparse_products.dot(r, z), 0.0, 1.0
    for iteration in range(1, MAX_ITERATIONS + 1):
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
    return Correction(_displacement(x), MAX_ITERATIONS, error, False)


def solve_many(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Solve for each of `b`, (k, n, 3), to a relative error, `LANES` at a time.

    The error is estimated by the preconditioned residual: the residual itself hardly
    reflects the displacement where a stiff plate takes most of the force.
    """
    whole = len(b) if len(b) % LANES > SOLVED_ONE_BY_ONE else len(b) - len(b) % LANES
    parts = [
        _solve_block(operator, b[k : min(k + LANES, whole)], tolerance)
        for k in range(0, whole, LANES)
    ]
    parts += [_solve_one(operator, one, tolerance) for one in b[whole:]]
    if not parts:
        return Corrections(np.zeros_like(b), np.zeros(0, np.int64), np.zeros(0), False)
    return Corrections(
        np.concatenate([part.u for part in parts]),
        np.concatenate([part.iterations for part in parts]),
        np.concatenate([part.error for part in parts]),
        any(part.negative for part in parts),
    )


def _solve_one(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Solve for one right-hand side, (n, 3), to a relative error."""
    solution = solve(operator, b, tolerance, by_error=True)
    u = np.zeros_like(b) if solution.negative and solution.iterations == 1 else solution.u
    iterations, error = np.array([solution.iterations]), np.array([solution.error])
    return Corrections(u[None], iterations, error, solution.negative)


def _solve_block(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
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
    for iteration in range(1, MAX_ITERATIONS + 1):
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
