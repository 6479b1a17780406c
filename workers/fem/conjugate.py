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


@dataclass(frozen=True, eq=False)
class Correction:
    """A solution of the linear system, shape (n, 3), and how it was found.

    ``negative`` tells that a direction of negative curvature ended the iteration.
    """

    u: FloatArray
    iterations: int
    negative: bool


@dataclass(frozen=True, eq=False)
class Corrections:
    """Solutions for several right-hand sides.

    Parameters
    ----------
    u : ndarray, shape (k, n, 3)
    iterations : ndarray of int, shape (k,)
    residual : ndarray, shape (k,)
        Norm of what is left over that of the right-hand side; larger than asked
        for where the iteration ended early.
    negative : bool
        A direction of negative curvature was met: the tangent is not stable.
    """

    u: FloatArray
    iterations: NDArray[np.int64]
    residual: FloatArray
    negative: bool


class Operator(Protocol):
    """A tangent that multiplies and preconditions vectors of either shape."""

    def apply(self, x: FloatArray, y: FloatArray) -> None:
        """y = tangent times x; sets the pressure of `x`."""

    def precondition(self, b: Float32Array) -> Float32Array:
        """Solve roughly."""


def solve(operator: Operator, b: FloatArray, tolerance: float) -> Correction:
    """Solve for `b`, (n, 3), to a relative residual."""
    r = np.zeros((len(b), 4))
    r[:, :3] = b
    x, p, y = np.zeros_like(r), np.zeros_like(r), np.zeros_like(r)
    single = r.astype(np.float32)
    norm = np.sqrt(rows.dot(r, r))
    if norm == 0:
        return Correction(np.zeros_like(b), 0, False)
    z = operator.precondition(single)
    rz, beta = rows.dot(r, z), 0.0
    for iteration in range(1, MAX_ITERATIONS + 1):
        rows.turn(beta, z, p)
        operator.apply(p, y)
        curvature = rows.dot(p, y)
        if curvature <= 0 or rz <= 0:
            return Correction(_three(p if iteration == 1 else x), iteration, True)
        alpha = rz / curvature
        rows.advance(alpha, p, y, x, r)
        if np.sqrt(rows.dot(r, r)) < tolerance * norm:
            return Correction(_three(x), iteration, False)
        single[:] = r
        z = operator.precondition(single)
        beta = -alpha * rows.dot(y, z) / rz
        rz = rows.dot(r, z)
    return Correction(_three(x), MAX_ITERATIONS, False)


def solve_many(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Solve for each of `b`, (k, n, 3), to a relative residual, `LANES` at a time."""
    parts = [_solve_block(operator, b[k : k + LANES], tolerance) for k in range(0, len(b), LANES)]
    if not parts:
        return Corrections(np.zeros_like(b), np.zeros(0, np.int64), np.zeros(0), False)
    return Corrections(
        np.concatenate([part.u for part in parts]),
        np.concatenate([part.iterations for part in parts]),
        np.concatenate([part.residual for part in parts]),
        any(part.negative for part in parts),
    )


def _solve_block(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Up to `LANES` right-hand sides; a lane that is done stands still."""
    k = len(b)
    r = np.zeros((b.shape[1], 4, LANES))
    r[:, :3, :k] = np.moveaxis(b, 0, -1)
    x, p, y, z = (np.zeros_like(r) for _ in range(4))
    single = np.empty_like(r, dtype=np.float32)
    norm = np.sqrt(_dot(r, r))
    left = norm.copy()
    active = norm > 0
    iterations = np.zeros(LANES, np.int64)
    negative = False
    rz, alpha, beta = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for iteration in range(1, MAX_ITERATIONS + 1):
        if not active.any():
            break
        single[:] = r
        z[:] = operator.precondition(single)
        if iteration > 1:
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
        left = np.sqrt(_dot(r, r))
        iterations[active] = iteration
        active &= left >= tolerance * norm
    u = np.ascontiguousarray(np.moveaxis(x[:, :3, :k], -1, 0))
    return Corrections(u, iterations[:k], _over(left, norm, norm > 0)[:k], negative)


def _three(x: FloatArray) -> FloatArray:
    return np.ascontiguousarray(x[:, :3])


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    sums = np.empty(LANES)
    rows_many.dot(a, b, sums)
    return sums


def _over(a: FloatArray, b: FloatArray, where: NDArray[Any]) -> FloatArray:
    """a / b, or zero elsewhere."""
    return np.divide(a, b, out=np.zeros_like(a), where=where)
