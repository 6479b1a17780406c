"""The tangent beside its product: block Jacobi and the dense matrix.

Both are made from packed rows (`workers.fem.rows`). `free`, (n, 3), is 1 where a
displacement is unknown and 0 where it is held.

What the memory and the processor are asked for, at 14.4 edges and 5.5
tetrahedra a node, and what one thread of a Zen 5 at 90k nodes reached:

======================= ============= ============ ======= ====================
work                    bytes a node  flops a node ms      reached
======================= ============= ============ ======= ====================
product                 750           350          2.6     26 GB/s, 12 Gflop/s
smoothing sweep         870           460          3.9     20 GB/s, 11 Gflop/s
product, 8 together     970           2,800        7.2     12 GB/s, 35 Gflop/s
sweep, 8 together       1,700         3,700        14      11 GB/s, 23 Gflop/s
assembly                2,600         5,000        60      4 GB/s, 8 Gflop/s
======================= ============= ============ ======= ====================

A product waits for memory at 90k nodes; at 20k its 14 MB stay in the cache and
it takes 0.23 ms. Assembly spends a third of its time on the force, a third on the
blocks and a third on adding each element's sixteen edges where they belong.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from storage.values import FloatArray, IntArray
from workers.fem.kernels import COMPILE

AnyFloat = NDArray[np.floating[Any]]


@njit(**COMPILE)
def invert_diagonal(
    start: IntArray, diagonal: IntArray, rows: AnyFloat, free: AnyFloat, inverse: AnyFloat
) -> None:
    """Inverse 3 x 3 diagonal blocks, (n, 9), made safely positive; zero where held."""
    n = start.shape[0] - 1
    m = np.empty((3, 3))
    for i in range(n):
        q = diagonal[i]
        for a in range(3):
            for b in range(3):
                m[a, b] = 0.5 * (rows[q, 4 * a + b] + rows[q, 4 * b + a])
        for q in range(start[i], start[i + 1]):
            for a in range(3):
                for b in range(3):
                    m[a, b] += rows[q, 4 * a + 3] * rows[q, 4 * b + 3]
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
def dense(start: IntArray, neighbour: IntArray, rows: AnyFloat, free: AnyFloat) -> FloatArray:
    """The tangent as a full symmetric matrix, (3 n, 3 n); 1 on the diagonal where held."""
    n = start.shape[0] - 1
    A = np.zeros((3 * n, 3 * n))
    for i in range(n):
        for q in range(start[i], start[i + 1]):
            j = neighbour[q]
            for a in range(3):
                for b in range(3):
                    A[3 * i + a, 3 * j + b] += rows[q, 4 * a + b]
    # B on row i, column j is dv_j/du_i, and the pattern is symmetric: the rows of
    # node j list all i with a share in v_j, but hold dv_i/du_j. Collect the column first.
    for j in range(n):
        width = start[j + 1] - start[j]
        g = np.empty((width, 3))
        for p in range(width):
            i = neighbour[start[j] + p]
            q = start[i] + np.searchsorted(neighbour[start[i] : start[i + 1]], j)
            for a in range(3):
                g[p, a] = rows[q, 4 * a + 3]
        for p in range(width):
            i = neighbour[start[j] + p]
            for a in range(3):
                left = g[p, a]
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
