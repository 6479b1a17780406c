"""Sparsity of a tangent, and the coarse blocks to which its blocks contribute."""

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.sparse import csr_matrix

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.blind.solver.quadratic_element import QuadraticMesh
from palpate.workers.compile_flags import CONTRACTED


class Pattern(NamedTuple):
    """Blocks of 3 x 3 in compressed rows: starts (n + 1,), columns (b,), sorted."""

    starts: IntArray
    columns: IntArray


def pattern_of(cells: IntArray, count: int) -> Pattern:
    """Find the blocks filled by elements with these nodes.

    Parameters
    ----------
    cells : ndarray of int, shape (m, a)
    count : int
        Number of nodes.
    """
    m, a = cells.shape
    touch = csr_matrix(
        (np.ones(m * a), cells.ravel(), np.arange(0, m * a + 1, a)), shape=(m, count)
    )
    joined = (touch.T @ touch).tocsr()
    joined.sort_indices()
    return Pattern(joined.indptr.astype(np.int32), joined.indices.astype(np.int32))


@njit(**CONTRACTED)
def _slot(starts: IntArray, columns: IntArray, row: int, column: int) -> int:
    low, high = starts[row], starts[row + 1]
    while low < high:
        middle = (low + high) // 2
        if columns[middle] < column:
            low = middle + 1
        else:
            high = middle
    return low


@njit(**CONTRACTED)
def slots_of(cells: IntArray, starts: IntArray, columns: IntArray) -> IntArray:
    """Return the block index of every pair of nodes of every element, (m, a, a) int32."""
    m, a = cells.shape
    out = np.empty((m, a, a), np.int32)
    for e in range(m):
        for i in range(a):
            for j in range(a):
                out[e, i, j] = _slot(starts, columns, cells[e, i], cells[e, j])
    return out


class Coarsening(NamedTuple):
    """Blocks of the corners, and the targets of the blocks of all nodes.

    Parameters
    ----------
    pattern : Pattern
        Pattern of the corners.
    targets : ndarray of int32, shape (b, 4)
        A mid-edge node moves with the mean of its ends: each block adds a quarter of itself to
        four coarse ones.
    """

    pattern: Pattern
    targets: IntArray


def coarsening_of(mesh: QuadraticMesh, pattern: Pattern) -> Coarsening:
    """Return the mapping of the blocks of ten-node elements to the blocks of their corners."""
    coarse = pattern_of(mesh.cells[:, :4], mesh.corners)
    rows = np.repeat(np.arange(len(mesh.nodes), dtype=np.int32), np.diff(pattern.starts))
    return Coarsening(coarse, _targets(*coarse, mesh.ends[rows], mesh.ends[pattern.columns]))


@njit(**CONTRACTED)
def _targets(starts: IntArray, columns: IntArray, rows: IntArray, others: IntArray) -> IntArray:
    out = np.empty((len(rows), 4), np.int32)
    for b in range(len(rows)):
        for k in range(4):
            out[b, k] = _slot(starts, columns, rows[b, k // 2], others[b, k % 2])
    return out


@njit(**CONTRACTED)
def coarsened(targets: IntArray, fine: FloatArray, out: FloatArray) -> None:
    """Store the Galerkin product with the interpolation from the corners, `out` (c, 3, 3)."""
    out[:] = 0.0
    for b in range(len(targets)):
        for k in range(4):
            t = targets[b, k]
            for i in range(3):
                for j in range(3):
                    out[t, i, j] += 0.25 * fine[b, i, j]
