"""The tangent as it is assembled: its product, block Jacobi, its dense matrix.

The tangent is ``K + B diag(D) B^T``: K in 3 x 3 blocks over the edges of the
mesh, B (the derivatives of the nodal volumes) in 3-vectors over the same edges,
D = kappa_n / V_n per node. Both are stored in single precision, vectors in the
precision of the caller. `free`, (n, 3), is 1 where a displacement is unknown
and 0 where it is held. `multiply` takes the arrays as they are; solvers pack
them first (`workers.fem.rows`).

What the memory and the processor are asked for, at 14.4 edges and 5.5
tetrahedra a node, and what one thread of a Zen 5 at 90k nodes reached:

======================= ============= ============ ======= ====================
work                    bytes a node  flops a node ms      reached
======================= ============= ============ ======= ====================
`multiply`              980           430          5.5     16 GB/s, 7 Gflop/s
packed product alone    750           350          2.6     26 GB/s, 12 Gflop/s
smoothing sweep         870           460          3.9     20 GB/s, 11 Gflop/s
assembly                1,800         5,000        140     1 GB/s, 3 Gflop/s
======================= ============= ============ ======= ====================

A packed product waits for memory at 90k nodes; at 20k its 14 MB stay in the
cache and it takes 0.23 ms, five times less than `multiply`. Assembly waits for
arithmetic and for adding into 256 numbers of an element, not for memory.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from storage.values import FloatArray, IntArray
from workers.fem.kernels import COMPILE

AnyFloat = NDArray[np.floating[Any]]


@njit(**COMPILE)
def multiply(
    start: IntArray,
    neighbour: IntArray,
    K: AnyFloat,
    B: AnyFloat,
    D: AnyFloat,
    free: AnyFloat,
    x: AnyFloat,
    pressure: AnyFloat,
    y: AnyFloat,
) -> None:
    """y = (K + B D B^T) x on the free unknowns; `pressure`, (n,), is scratch."""
    n = x.shape[0]
    pressure[:] = 0.0
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for q in range(start[i], start[i + 1]):
            pressure[neighbour[q]] += B[q, 0] * x0 + B[q, 1] * x1 + B[q, 2] * x2
    for i in range(n):
        pressure[i] *= D[i]
    for i in range(n):
        s0 = x.dtype.type(0)
        s1 = s0
        s2 = s0
        for q in range(start[i], start[i + 1]):
            j = neighbour[q]
            x0, x1, x2 = x[j, 0], x[j, 1], x[j, 2]
            p = pressure[j]
            s0 += K[q, 0] * x0 + K[q, 1] * x1 + K[q, 2] * x2 + B[q, 0] * p
            s1 += K[q, 3] * x0 + K[q, 4] * x1 + K[q, 5] * x2 + B[q, 1] * p
            s2 += K[q, 6] * x0 + K[q, 7] * x1 + K[q, 8] * x2 + B[q, 2] * p
        y[i, 0] = s0 * free[i, 0]
        y[i, 1] = s1 * free[i, 1]
        y[i, 2] = s2 * free[i, 2]


@njit(**COMPILE)
def invert_diagonal(
    start: IntArray,
    neighbour: IntArray,
    diagonal: IntArray,
    K: AnyFloat,
    B: AnyFloat,
    D: AnyFloat,
    free: AnyFloat,
    inverse: AnyFloat,
) -> None:
    """Inverse 3 x 3 diagonal blocks, (n, 9), made safely positive; zero where held."""
    n = start.shape[0] - 1
    m = np.empty((3, 3))
    for i in range(n):
        q = diagonal[i]
        for a in range(3):
            for b in range(3):
                m[a, b] = 0.5 * (K[q, 3 * a + b] + K[q, 3 * b + a])
        for q in range(start[i], start[i + 1]):
            d = D[neighbour[q]]
            for a in range(3):
                for b in range(3):
                    m[a, b] += d * B[q, a] * B[q, b]
        shift = 1e-3 * (abs(m[0, 0]) + abs(m[1, 1]) + abs(m[2, 2])) / 3.0
        for a in range(3):
            m[a, a] = abs(m[a, a]) + shift
            if free[i, a] == 0:
                for b in range(3):
                    m[a, b] = 0.0
                    m[b, a] = 0.0
                m[a, a] = 1.0
        _invert_positive(m, shift)
        for a in range(3):
            for b in range(3):
                held = free[i, a] == 0 or free[i, b] == 0
                inverse[i, 3 * a + b] = 0.0 if held else m[a, b]


@njit(inline="always", **COMPILE)
def _invert_positive(m: FloatArray, shift: float) -> None:
    """Invert a symmetric 3 x 3 matrix in place, damping off-diagonals until it is positive."""
    for _ in range(40):
        c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
        c01 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
        c02 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
        det = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
        minor = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
        if minor > 0.0 and det > 1e-6 * m[0, 0] * m[1, 1] * m[2, 2]:
            break
        for a in range(3):
            for b in range(3):
                if a != b:
                    m[a, b] *= 0.7
    r = 1.0 / det
    i00, i01, i02 = c00 * r, (m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]) * r, 0.0
    i02 = (m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]) * r
    i11 = (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]) * r
    i12 = (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]) * r
    i22 = minor * r
    m[0, 0], m[1, 1], m[2, 2] = i00, i11, i22
    m[0, 1], m[1, 0] = i01, i01
    m[0, 2], m[2, 0] = i02, i02
    m[1, 2], m[2, 1] = i12, i12


@njit(**COMPILE)
def apply_diagonal(inverse: AnyFloat, r: AnyFloat, z: AnyFloat) -> None:
    """z = inverse r, block by block."""
    for i in range(r.shape[0]):
        r0, r1, r2 = r[i, 0], r[i, 1], r[i, 2]
        z[i, 0] = inverse[i, 0] * r0 + inverse[i, 1] * r1 + inverse[i, 2] * r2
        z[i, 1] = inverse[i, 3] * r0 + inverse[i, 4] * r1 + inverse[i, 5] * r2
        z[i, 2] = inverse[i, 6] * r0 + inverse[i, 7] * r1 + inverse[i, 8] * r2


@njit(**COMPILE)
def dense(
    start: IntArray, neighbour: IntArray, K: AnyFloat, B: AnyFloat, D: AnyFloat, free: AnyFloat
) -> FloatArray:
    """The tangent as a full symmetric matrix, (3 n, 3 n); 1 on the diagonal where held."""
    n = start.shape[0] - 1
    A = np.zeros((3 * n, 3 * n))
    for i in range(n):
        for q in range(start[i], start[i + 1]):
            j = neighbour[q]
            for a in range(3):
                for b in range(3):
                    A[3 * i + a, 3 * j + b] += K[q, 3 * a + b]
    # B[q] on row i, column j is dv_j/du_i, and the pattern is symmetric: the rows of
    # node j list all i with a share in v_j, but hold dv_i/du_j. Collect the column first.
    for j in range(n):
        width = start[j + 1] - start[j]
        g = np.empty((width, 3))
        for p in range(width):
            i = neighbour[start[j] + p]
            q = start[i] + np.searchsorted(neighbour[start[i] : start[i + 1]], j)
            for a in range(3):
                g[p, a] = B[q, a]
        for p in range(width):
            i = neighbour[start[j] + p]
            for a in range(3):
                left = D[j] * g[p, a]
                for o in range(width):
                    k = neighbour[start[j] + o]
                    for b in range(3):
                        A[3 * i + a, 3 * k + b] += left * g[o, b]
    for i in range(n):
        for a in range(3):
            if free[i, a] == 0:
                A[3 * i + a, :] = 0.0
                A[:, 3 * i + a] = 0.0
                A[3 * i + a, 3 * i + a] = 1.0
    return A
