"""Conjugate gradients, for one right-hand side and for several that travel together.

Vectors are in double precision, (n, 4) or (n, 4, LANES); see `workers.fem.rows`.
The preconditioner may differ a little from one call to the next (it rounds to
single precision), hence the Polak-Ribiere form, with ``r_new - r = -alpha A p``.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from storage.values import FloatArray
from workers.fem import rows, rows_many
from workers.fem.kernels import Float32Array
from workers.fem.lanes import LANES

MAX_ITERATIONS = 120
# A block costs as much as this many right-hand sides and a little more.
ALONE = 2


@dataclass(frozen=True, eq=False)
class Correction:
    """A solution of the linear system, shape (n, 3), and how it was found.

    ``left`` is what was asked to be less than the tolerance; ``negative`` tells that a
    direction of negative curvature ended the iteration.
    """

    u: FloatArray
    iterations: int
    left: float
    negative: bool


@dataclass(frozen=True, eq=False)
class Corrections:
    """Solutions for several right-hand sides.

    Parameters
    ----------
    u : ndarray, shape (k, n, 3)
    iterations : ndarray of int, shape (k,)
    error : ndarray, shape (k,)
        Relative error, estimated; larger than asked for where the iteration ended early.
    negative : bool
        A direction of negative curvature was met: the tangent is not stable.
    """

    u: FloatArray
    iterations: NDArray[np.int64]
    error: FloatArray
    negative: bool


class Operator(Protocol):
    """A tangent that multiplies and preconditions vectors of either shape."""

    def apply(self, x: FloatArray, y: FloatArray) -> None:
        """y = tangent times x; sets the pressure of `x`."""

    def precondition(self, b: Float32Array) -> Float32Array:
        """Solve roughly."""


def solve(
    operator: Operator, b: FloatArray, tolerance: float, *, by_error: bool = False
) -> Correction:
    """Solve for `b`, (n, 3), to a relative residual, or to a relative error as `solve_many`."""
    r = np.zeros((len(b), 4))
    r[:, :3] = b
    x, p, y = np.zeros_like(r), np.zeros_like(r), np.zeros_like(r)
    single = r.astype(np.float32)
    norm = np.sqrt(rows.dot(r, r))
    if norm == 0:
        return Correction(np.zeros_like(b), 0, 0.0, False)
    z = operator.precondition(single)
    rz, beta, left = rows.dot(r, z), 0.0, 1.0
    for iteration in range(1, MAX_ITERATIONS + 1):
        rows.turn(beta, z, p)
        operator.apply(p, y)
        curvature = rows.dot(p, y)
        if curvature <= 0 or rz <= 0:
            return Correction(_three(p if iteration == 1 else x), iteration, left, True)
        alpha = rz / curvature
        rows.advance(alpha, p, y, x, r)
        if not by_error:
            left = float(np.sqrt(rows.dot(r, r)) / norm)
            if left < tolerance:
                return Correction(_three(x), iteration, left, False)
        single[:] = r
        z = operator.precondition(single)
        if by_error:
            left = float(np.sqrt(rows.dot(z, z) / rows.dot(x, x)))
            if left < tolerance:
                return Correction(_three(x), iteration, left, False)
        beta = -alpha * rows.dot(y, z) / rz
        rz = rows.dot(r, z)
    return Correction(_three(x), MAX_ITERATIONS, left, False)


def solve_many(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Solve for each of `b`, (k, n, 3), to a relative error, `LANES` at a time.

    The error is measured by what the preconditioner would still add: a residual says
    little of the displacement where a stiff plate takes most of the force.
    """
    whole = len(b) if len(b) % LANES > ALONE else len(b) - len(b) % LANES
    parts = [
        _solve_block(operator, b[k : min(k + LANES, whole)], tolerance)
        for k in range(0, whole, LANES)
    ]
    parts += [_solve_alone(operator, one, tolerance) for one in b[whole:]]
    if not parts:
        return Corrections(np.zeros_like(b), np.zeros(0, np.int64), np.zeros(0), False)
    return Corrections(
        np.concatenate([part.u for part in parts]),
        np.concatenate([part.iterations for part in parts]),
        np.concatenate([part.error for part in parts]),
        any(part.negative for part in parts),
    )


def _solve_alone(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    found = solve(operator, b, tolerance, by_error=True)
    u = np.zeros_like(b) if found.negative and found.iterations == 1 else found.u
    iterations, error = np.array([found.iterations]), np.array([found.left])
    return Corrections(u[None], iterations, error, found.negative)


def _solve_block(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Up to `LANES` right-hand sides; a lane that is done stands still."""
    k = len(b)
    r = np.zeros((b.shape[1], 4, LANES))
    r[:, :3, :k] = np.moveaxis(b, 0, -1)
    x, p, y, z = (np.zeros_like(r) for _ in range(4))
    single = np.empty_like(r, dtype=np.float32)
    active = _dot(r, r) > 0
    left = active.astype(np.float64)
    iterations = np.zeros(LANES, np.int64)
    negative = False
    rz, alpha, beta = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for iteration in range(1, MAX_ITERATIONS + 1):
        single[:] = r
        z[:] = operator.precondition(single)
        if iteration > 1:
            left[active] = np.sqrt(_over(_dot(z, z), _dot(x, x), active))[active]
            active &= left >= tolerance
            if not active.any():
                break
            beta = -alpha * _over(_dot(y, z), rz, active)
        rz = _dot(r, z)
        rows_many.turn(beta, z, p)
        operator.apply(p, y)
        curvature = _dot(p, y)
        unstable = active & ((curvature <= 0) | (rz <= 0))
        negative = negative or bool(unstable.any())
        active &= ~unstable
        alpha = _over(rz, curvature, active)
        rows_many.advance(alpha, p, y, x, r)
        iterations[active] = iteration
    u = np.ascontiguousarray(np.moveaxis(x[:, :3, :k], -1, 0))
    return Corrections(u, iterations[:k], left[:k], negative)


def _three(x: FloatArray) -> FloatArray:
    return np.ascontiguousarray(x[:, :3])


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    sums = np.empty(LANES)
    rows_many.dot(a, b, sums)
    return sums


def _over(a: FloatArray, b: FloatArray, where: NDArray[Any]) -> FloatArray:
    """a / b, or zero elsewhere."""
    return np.divide(a, b, out=np.zeros_like(a), where=where)
