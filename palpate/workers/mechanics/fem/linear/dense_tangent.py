"""Tangent of a small mesh as a full matrix, for factorisation."""

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.compile_flags import CONTRACTED
from palpate.workers.mechanics.fem.problem.array_types import Float32Array


@njit(**CONTRACTED)
def dense_matrix(
    start: IntArray, neighbour: IntArray, rows: Float32Array, free: Float32Array
) -> FloatArray:
    """Return the tangent as a full symmetric matrix, (3 n, 3 n); 1 on the diagonal where held."""
    n = start.shape[0] - 1
    A = np.zeros((3 * n, 3 * n))
    for i in range(n):
        for q in range(start[i], start[i + 1]):
            j = neighbour[q]
            for a in range(3):
                for b in range(3):
                    A[3 * i + a, 3 * j + b] += rows[q, 4 * a + b]
    # B on row i, column j is dv_j/du_i, and the pattern is symmetric: the rows of
    # node j list all i with a share in v_j, but contain dv_i/du_j. Collect the column first.
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
