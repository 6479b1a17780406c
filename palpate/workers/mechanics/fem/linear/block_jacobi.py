"""Block Jacobi: the inverse 3 x 3 diagonal blocks of a tangent.

They are computed from packed rows (`mechanics.fem.linear.sparse_products`). `free`, (n, 3), is 1
where a displacement is unknown and 0 where it is held.
"""

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.compile_flags import CONTRACTED
from palpate.workers.mechanics.fem.problem.array_types import Float32Array


@njit(**CONTRACTED)
def invert_diagonal(
    start: IntArray,
    diagonal: IntArray,
    rows: Float32Array,
    free: Float32Array,
    inverse: Float32Array,
) -> None:
    """Set `inverse`, (n, 9), to inverse diagonal blocks, made positive; zero where held."""
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


@njit(inline="always", **CONTRACTED)
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


@njit(**CONTRACTED)
def apply_diagonal(inverse: Float32Array, r: Float32Array, z: Float32Array) -> None:
    """Set z = inverse r, block by block; both (n, 4)."""
    for i in range(r.shape[0]):
        r0, r1, r2 = r[i, 0], r[i, 1], r[i, 2]
        z[i, 0] = inverse[i, 0] * r0 + inverse[i, 1] * r1 + inverse[i, 2] * r2
        z[i, 1] = inverse[i, 3] * r0 + inverse[i, 4] * r1 + inverse[i, 5] * r2
        z[i, 2] = inverse[i, 6] * r0 + inverse[i, 7] * r1 + inverse[i, 8] * r2
