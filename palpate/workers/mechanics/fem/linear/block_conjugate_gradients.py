"""Conjugate gradients for blocks of right-hand sides that share their search directions.

In each iteration every right-hand side uses the directions of all (D. P. O'Leary, Linear
Algebra Appl. 29 (1980) 293): a fifth to a quarter fewer iterations than with its own alone, for
some 200 lumps or attachments of a breast with 5000 nodes. Nearly dependent directions are
dropped, because their products have no inverse.
"""

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray
from palpate.workers.compile_flags import CONTRACTED
from palpate.workers.mechanics.fem.elements.simd import LANES, load, store
from palpate.workers.mechanics.fem.linear import conjugate_gradients, sparse_products
from palpate.workers.mechanics.fem.linear.conjugate_gradients import (
    MAX_ITERATIONS,
    Corrections,
    Operator,
)

# For curvatures along mixtures of directions, each direction scaled to a curvature of one.
LEAST_CURVATURE = 1e-10


def solve_many(operator: Operator, b: FloatArray, tolerance: float) -> Corrections:
    """Solve for each of `b`, (k, n, 3), to a relative error, in full blocks of `LANES`.

    The remainder, and blocks that meet negative curvature, are solved by
    `conjugate_gradients.solve_many`, which defines the error.
    """
    full = len(b) - len(b) % LANES
    parts = []
    for k in range(0, full, LANES):
        block = b[k : k + LANES]
        solved = _solve_block(operator, block, tolerance)
        parts.append(solved or conjugate_gradients.solve_many(operator, block, tolerance))
    parts.append(conjugate_gradients.solve_many(operator, b[full:], tolerance))
    return Corrections(
        np.concatenate([part.u for part in parts]),
        np.concatenate([part.iterations for part in parts]),
        np.concatenate([part.error for part in parts]),
        any(part.negative for part in parts),
    )


def _solve_block(operator: Operator, b: FloatArray, tolerance: float) -> Corrections | None:
    """Solve for `LANES` right-hand sides; None if a direction has negative curvature."""
    r = np.zeros((b.shape[1], 4, LANES))
    r[:, :3] = np.moveaxis(b, 0, -1)
    x, p, y, z = (np.zeros_like(r) for _ in range(4))
    single = np.empty_like(r, dtype=np.float32)
    error = (_lengths(r) > 0).astype(np.float64)
    iterations = np.zeros(LANES, np.int64)
    beta, inverse = np.zeros((2, LANES, LANES))
    for iteration in range(1, MAX_ITERATIONS + 1):
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
        found = _inverse(_products(p, y))
        if found is None:
            return None
        inverse = found
        take_steps(inverse @ _products(p, r), p, y, x, r)
    u = np.ascontiguousarray(np.moveaxis(x[:, :3], -1, 0))
    return Corrections(u, iterations, error, False)


def _inverse(curvature: FloatArray) -> FloatArray | None:
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
