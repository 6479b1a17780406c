"""One right-hand side: products and smoothing with packed rows of the tangent.

The tangent is ``K + B diag(D) B^T``: K in 3 x 3 blocks over the edges of the mesh, B
(the derivatives ``d v_j / d u_i`` of the nodal volumes) in 3-vectors over the same
edges, D = kappa_n / V_n per node.

An edge i-j is packed into twelve numbers, three rows of ``(K, K, K, B)`` with
``B sqrt(D_j)`` in the last place, and a vector has four at a node: ``(x, y, z, p)``
with ``p = sqrt(D) B^T x``, its *pressure*. A row of the product ``(K + B D B^T) x``
is then one sum of ``edge * (x, y, z, p)`` over the neighbours.

A smoothing sweep reads the matrix once: when node i has its new step, its share
in the pressure of the neighbours is spread from the same packed edges.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from storage.values import FloatArray, IntArray
from workers.fem.edges import edge_add, edge_sums, edge_zero
from workers.fem.kernels import COMPILE, Float32Array

AnyFloat = NDArray[np.floating[Any]]
IndexArray = NDArray[np.uint32]  # unsigned: a compiled loop need not ask for negative indices


@njit(**COMPILE)
def hold(start: IntArray, free: Float32Array, rows: Float32Array) -> None:
    """Empty the rows of held displacements, where `free`, (n, 3), is zero."""
    for i in range(free.shape[0]):
        for a in range(3):
            if free[i, a] == 0:
                for q in range(start[i], start[i + 1]):
                    rows[q, 4 * a : 4 * a + 4] = 0


@njit(inline="always", **COMPILE)
def _spread(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloat
) -> None:
    """Add node i's share to the pressure of its neighbours."""
    x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
    for q in range(start[i], start[i + 1]):
        x[neighbour[q], 3] += rows[q, 3] * x0 + rows[q, 7] * x1 + rows[q, 11] * x2


@njit(inline="always", **COMPILE)
def _row(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, i: int, x: AnyFloat
) -> tuple[float, float, float]:
    """Row i of the product; `x` knows its pressure."""
    total = edge_zero(x)
    for q in range(start[i], start[i + 1]):
        total = edge_add(total, rows, q, x, neighbour[q])
    return edge_sums(total)


@njit(**COMPILE)
def pressurise(start: IndexArray, neighbour: IndexArray, rows: Float32Array, x: AnyFloat) -> None:
    """Set the pressure of `x`, (n, 4), whose held displacements are zero."""
    x[:, 3] = 0
    for i in range(x.shape[0]):
        _spread(start, neighbour, rows, i, x)


@njit(**COMPILE)
def multiply(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, x: AnyFloat, y: AnyFloat
) -> None:
    """y = tangent times x, both (n, 4); the pressure of `y` is left alone."""
    for i in range(x.shape[0]):
        y[i, 0], y[i, 1], y[i, 2] = _row(start, neighbour, rows, i, x)


@njit(**COMPILE)
def subtract(
    start: IndexArray, neighbour: IndexArray, rows: Float32Array, x: AnyFloat, r: AnyFloat
) -> None:
    """r -= tangent times x, both (n, 4)."""
    for i in range(x.shape[0]):
        s0, s1, s2 = _row(start, neighbour, rows, i, x)
        r[i, 0] -= s0
        r[i, 1] -= s1
        r[i, 2] -= s2


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
    """step = scale * inverse r with its pressure; `inverse` is block Jacobi, (n, 9)."""
    step[:, 3] = 0
    for i in range(r.shape[0]):
        r0, r1, r2 = r[i, 0], r[i, 1], r[i, 2]
        for a in range(3):
            step[i, a] = scale * (
                inverse[i, 3 * a] * r0 + inverse[i, 3 * a + 1] * r1 + inverse[i, 3 * a + 2] * r2
            )
        _spread(start, neighbour, rows, i, step)


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
    """Take the step `old` and find the next one, all (n, 4).

    ``r -= tangent old``, ``new = keep * old + scale * inverse r``, ``x += new``;
    the pressure of `new` only if `spread`.
    """
    new[:, 3] = 0
    for i in range(x.shape[0]):
        s0, s1, s2 = _row(start, neighbour, rows, i, old)
        r0, r1, r2 = r[i, 0] - s0, r[i, 1] - s1, r[i, 2] - s2
        r[i, 0], r[i, 1], r[i, 2] = r0, r1, r2
        for a in range(3):
            new[i, a] = keep * old[i, a] + scale * (
                inverse[i, 3 * a] * r0 + inverse[i, 3 * a + 1] * r1 + inverse[i, 3 * a + 2] * r2
            )
            x[i, a] += new[i, a]
        if spread:
            _spread(start, neighbour, rows, i, new)


@njit(**COMPILE)
def add_rank_one(
    pads: IntArray, coupling: AnyFloat, factor: float, x: AnyFloat, y: AnyFloat
) -> None:
    """y += factor * c (c . x), with c = `coupling`, (c, 3), on `pads`."""
    s = 0.0
    for q in range(pads.shape[0]):
        i = pads[q]
        s += coupling[q, 0] * x[i, 0] + coupling[q, 1] * x[i, 1] + coupling[q, 2] * x[i, 2]
    s *= factor
    for q in range(pads.shape[0]):
        i = pads[q]
        for a in range(3):
            y[i, a] += s * coupling[q, a]


@njit(**COMPILE)
def dot(a: AnyFloat, b: AnyFloat) -> float:
    """a . b without the pressures, in double precision."""
    s0, s1, s2 = 0.0, 0.0, 0.0
    for i in range(a.shape[0]):
        s0 += a[i, 0] * b[i, 0]
        s1 += a[i, 1] * b[i, 1]
        s2 += a[i, 2] * b[i, 2]
    return s0 + s1 + s2


@njit(**COMPILE)
def advance(alpha: float, p: FloatArray, y: FloatArray, x: FloatArray, r: FloatArray) -> None:
    """x += alpha p and r -= alpha y."""
    for i in range(x.shape[0]):
        for a in range(3):
            x[i, a] += alpha * p[i, a]
            r[i, a] -= alpha * y[i, a]


@njit(**COMPILE)
def turn(beta: float, z: AnyFloat, p: FloatArray) -> None:
    """p = z + beta p."""
    for i in range(p.shape[0]):
        for a in range(3):
            p[i, a] = z[i, a] + beta * p[i, a]
