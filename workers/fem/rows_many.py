"""`workers.fem.rows` for `LANES` right-hand sides at once.

A vector has shape (n, 4, LANES): one read of an edge serves all lanes, and each
operation works on all of them. See `rows` for what the functions do.
"""

import numpy as np
from numba import njit

from storage.values import FloatArray, IntArray
from workers.fem.kernels import COMPILE, Float32Array
from workers.fem.lanes import Vector, load, store, zero
from workers.fem.rows import AnyFloat, IndexArray


@njit(inline="always", **COMPILE)
def _row(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloat
) -> tuple[Vector, Vector, Vector]:
    s0 = zero(x)
    s1 = zero(x)
    s2 = zero(x)
    for q in range(start[i], start[i + 1]):
        j = 4 * neighbour[q]
        x0, x1, x2, p = load(x, j), load(x, j + 1), load(x, j + 2), load(x, j + 3)
        s0 = s0 + rows[q, 0] * x0 + rows[q, 1] * x1 + rows[q, 2] * x2 + rows[q, 3] * p
        s1 = s1 + rows[q, 4] * x0 + rows[q, 5] * x1 + rows[q, 6] * x2 + rows[q, 7] * p
        s2 = s2 + rows[q, 8] * x0 + rows[q, 9] * x1 + rows[q, 10] * x2 + rows[q, 11] * p
    return s0, s1, s2


@njit(inline="always", **COMPILE)
def _spread(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloat
) -> None:
    x0, x1, x2 = load(x, 4 * i), load(x, 4 * i + 1), load(x, 4 * i + 2)
    for q in range(start[i], start[i + 1]):
        j = 4 * neighbour[q] + 3
        store(x, j, load(x, j) + rows[q, 3] * x0 + rows[q, 7] * x1 + rows[q, 11] * x2)


@njit(**COMPILE)
def pressurise(start: IndexArray, neighbour: IndexArray, rows: Float32Array, x: AnyFloat) -> None:
    """Set the pressure of `x`, whose held displacements are zero."""
    x[:, 3] = 0
    for i in range(x.shape[0]):
        _spread(start, neighbour, rows, i, x)


@njit(**COMPILE)
def multiply(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, x: AnyFloat, y: AnyFloat
) -> None:
    """y = tangent times x; the pressure of `y` is left alone."""
    for i in range(x.shape[0]):
        s0, s1, s2 = _row(start, neighbour, rows, i, x)
        store(y, 4 * i, s0)
        store(y, 4 * i + 1, s1)
        store(y, 4 * i + 2, s2)


@njit(**COMPILE)
def first_step(
    start: IndexArray,
    neighbour: IndexArray,
    rows: Float32Array,
    inverse: Float32Array,
    scale: np.float32,
    r: Float32Array,
    step: Float32Array,
) -> None:
    """step = scale * inverse r with its pressure."""
    step[:, 3] = 0
    for i in range(r.shape[0]):
        r0, r1, r2 = load(r, 4 * i), load(r, 4 * i + 1), load(r, 4 * i + 2)
        for a in range(3):
            z = inverse[i, 3 * a] * r0 + inverse[i, 3 * a + 1] * r1 + inverse[i, 3 * a + 2] * r2
            store(step, 4 * i + a, scale * z)
        _spread(start, neighbour, rows, i, step)


@njit(**COMPILE)
def subtract(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, x: AnyFloat, r: AnyFloat
) -> None:
    """r -= tangent times x."""
    for i in range(x.shape[0]):
        s0, s1, s2 = _row(start, neighbour, rows, i, x)
        store(r, 4 * i, load(r, 4 * i) - s0)
        store(r, 4 * i + 1, load(r, 4 * i + 1) - s1)
        store(r, 4 * i + 2, load(r, 4 * i + 2) - s2)


@njit(**COMPILE)
def sweep(
    start: IndexArray,
    neighbour: IndexArray,
    rows: Float32Array,
    inverse: Float32Array,
    keep: np.float32,
    scale: np.float32,
    r: Float32Array,
    x: Float32Array,
    old: Float32Array,
    new: Float32Array,
    spread: bool,
) -> None:
    """``r -= tangent old``, ``new = keep * old + scale * inverse r``, ``x += new``."""
    new[:, 3] = 0
    for i in range(x.shape[0]):
        s0, s1, s2 = _row(start, neighbour, rows, i, old)
        r0 = load(r, 4 * i) - s0
        r1 = load(r, 4 * i + 1) - s1
        r2 = load(r, 4 * i + 2) - s2
        store(r, 4 * i, r0)
        store(r, 4 * i + 1, r1)
        store(r, 4 * i + 2, r2)
        for a in range(3):
            k = 4 * i + a
            z = inverse[i, 3 * a] * r0 + inverse[i, 3 * a + 1] * r1 + inverse[i, 3 * a + 2] * r2
            z = keep * load(old, k) + scale * z
            store(new, k, z)
            store(x, k, load(x, k) + z)
        if spread:
            _spread(start, neighbour, rows, i, new)


@njit(**COMPILE)
def add_rank_one(
    pads: IntArray, coupling: AnyFloat, factor: float, x: AnyFloat, y: AnyFloat
) -> None:
    """y += factor * c (c . x), with c = `coupling`, (c, 3), on `pads`."""
    s = zero(x)
    for q in range(pads.shape[0]):
        for a in range(3):
            s = s + coupling[q, a] * load(x, 4 * pads[q] + a)
    for q in range(pads.shape[0]):
        for a in range(3):
            k = 4 * pads[q] + a
            store(y, k, load(y, k) + factor * coupling[q, a] * s)


@njit(**COMPILE)
def dot(a: FloatArray, b: FloatArray, sums: FloatArray) -> None:
    """Products a . b of two blocks without their pressures into `sums`, (LANES,)."""
    s = zero(a)
    for i in range(a.shape[0]):
        for k in range(3):
            s = s + load(a, 4 * i + k) * load(b, 4 * i + k)
    store(sums, 0, s)


@njit(**COMPILE)
def advance(alpha: FloatArray, p: FloatArray, y: FloatArray, x: FloatArray, r: FloatArray) -> None:
    """x += alpha p and r -= alpha y; `alpha` is (LANES,)."""
    step = load(alpha, 0)
    for i in range(x.shape[0]):
        for a in range(3):
            k = 4 * i + a
            store(x, k, load(x, k) + step * load(p, k))
            store(r, k, load(r, k) - step * load(y, k))


@njit(**COMPILE)
def turn(beta: FloatArray, z: FloatArray, p: FloatArray) -> None:
    """p = z + beta p; `beta` is (LANES,)."""
    share = load(beta, 0)
    for i in range(p.shape[0]):
        for a in range(3):
            k = 4 * i + a
            store(p, k, load(z, k) + share * load(p, k))
