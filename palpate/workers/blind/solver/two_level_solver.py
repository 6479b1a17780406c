"""Conjugate gradients for a sparse tangent with one extra unknown, the travel of the plates.

The preconditioner is one symmetric two-level cycle: a sweep of block Gauss-Seidel over all
nodes, a sparse direct solution on the corners, travel included, and the backward sweep. The
sparsity of the tangent comes with the coarse blocks to which its blocks contribute.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from scipy.sparse import bsr_matrix, coo_array, csc_matrix, csr_matrix, hstack, vstack
from scipy.sparse.linalg import splu

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.blind.solver.quadratic_mesh import QuadraticMesh
from palpate.workers.kernels_and_threads import CONTRACTED


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


@njit(**CONTRACTED)
def block_product(
    starts: IntArray, columns: IntArray, blocks: FloatArray, x: FloatArray, out: FloatArray
) -> None:
    """Compute ``out = A x`` for blocks of 3 x 3 and x of shape (n, 3)."""
    for r in range(len(starts) - 1):
        a, b, c = 0.0, 0.0, 0.0
        for k in range(starts[r], starts[r + 1]):
            j = columns[k]
            B = blocks[k]
            x0, x1, x2 = x[j, 0], x[j, 1], x[j, 2]
            a += B[0, 0] * x0 + B[0, 1] * x1 + B[0, 2] * x2
            b += B[1, 0] * x0 + B[1, 1] * x1 + B[1, 2] * x2
            c += B[2, 0] * x0 + B[2, 1] * x1 + B[2, 2] * x2
        out[r, 0], out[r, 1], out[r, 2] = a, b, c


@njit(**CONTRACTED)
def _relax(
    starts: IntArray,
    columns: IntArray,
    blocks: FloatArray,
    inverses: FloatArray,
    right: FloatArray,
    x: FloatArray,
    forward: bool,
) -> None:
    """Do one sweep of block Gauss-Seidel in place."""
    n = len(starts) - 1
    for step in range(n):
        r = step if forward else n - 1 - step
        a, b, c = right[r, 0], right[r, 1], right[r, 2]
        for k in range(starts[r], starts[r + 1]):
            j = columns[k]
            if forward and j >= r:  # still zero
                break
            if j == r:
                continue
            B = blocks[k]
            x0, x1, x2 = x[j, 0], x[j, 1], x[j, 2]
            a -= B[0, 0] * x0 + B[0, 1] * x1 + B[0, 2] * x2
            b -= B[1, 0] * x0 + B[1, 1] * x1 + B[1, 2] * x2
            c -= B[2, 0] * x0 + B[2, 1] * x1 + B[2, 2] * x2
        D = inverses[r]
        for i in range(3):
            x[r, i] = D[i, 0] * a + D[i, 1] * b + D[i, 2] * c


@dataclass(frozen=True, eq=False)
class TwoLevel:
    """Symmetric preconditioner of a tangent; the coarse factor may come from an earlier tangent."""

    pattern: Pattern
    blocks: FloatArray
    border: FloatArray
    inverses: FloatArray
    interpolation: csc_matrix
    factor: Any

    def __call__(self, force: FloatArray, closing: float) -> tuple[FloatArray, float]:
        """Return an approximate solution for a right-hand side on nodes and travel."""
        starts, columns = self.pattern
        x = np.zeros_like(force)
        _relax(starts, columns, self.blocks, self.inverses, force, x, True)
        rest = np.empty_like(force)
        block_product(starts, columns, self.blocks, x, rest)
        rest = force - rest
        left = closing - float((self.border * x).sum())
        coarse = (self.interpolation.T @ rest).ravel()
        solved = self.factor.solve(np.append(coarse, left))
        x += self.interpolation @ solved[:-1].reshape(-1, 3)
        travel = float(solved[-1])
        _relax(starts, columns, self.blocks, self.inverses, force - travel * self.border, x, False)
        return x, travel


def factorised_coarse_tangent(
    coarsening: Coarsening,
    blocks: FloatArray,
    border: FloatArray,
    corner: float,
    interpolation: csc_matrix,
) -> Any:
    """Return the sparse factorisation of the corners' tangent with the travel."""
    starts, columns = coarsening.pattern
    coarse = np.empty((len(columns), 3, 3))
    coarsened(coarsening.targets, blocks, coarse)
    inner = bsr_matrix((coarse, columns, starts))
    edge = coo_array((interpolation.T @ border).reshape(-1, 1))
    # A plate without contact has no stiffness of its own.
    end = coo_array([[max(corner, 1e-6)]])
    whole = vstack([hstack([coo_array(inner), edge]), hstack([edge.T, end])]).tocsc()
    return splu(
        whole, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )


@dataclass(frozen=True, slots=True)
class LinearSolution:
    """A step, its number of iterations, and True if the tangent is indefinite."""

    u: FloatArray
    travel: float
    iterations: int
    indefinite: bool


def conjugate_gradients(
    cycle: TwoLevel,
    corner: float,
    force: FloatArray,
    closing: float,
    tolerance: float,
    most: int = 400,
) -> LinearSolution:
    """Solve for minus the out-of-balance force, to a relative tolerance.

    At a direction of negative curvature the step so far is returned, or the first direction
    itself: both are descent directions.
    """
    starts, columns = cycle.pattern
    x, t = np.zeros_like(force), 0.0
    r, rt = -force, -closing
    z, zt = cycle(r, rt)
    p, pt = z, zt
    rho = float((r * z).sum()) + rt * zt
    start, product_ = rho, np.empty_like(force)
    for iteration in range(1, most + 1):
        block_product(starts, columns, cycle.blocks, p, product_)
        ap = product_ + pt * cycle.border
        apt = float((cycle.border * p).sum()) + corner * pt
        curvature = float((p * ap).sum()) + pt * apt
        if not curvature > 0:
            if iteration == 1:
                x, t = z, zt
            return LinearSolution(x, t, iteration, True)
        alpha = rho / curvature
        x += alpha * p
        t += alpha * pt
        r -= alpha * ap
        rt -= alpha * apt
        z, zt = cycle(r, rt)
        fresh = float((r * z).sum()) + rt * zt
        if fresh <= tolerance**2 * start:
            return LinearSolution(x, t, iteration, False)
        p, pt = z + fresh / rho * p, zt + fresh / rho * pt
        rho = fresh
    return LinearSolution(x, t, most, False)
