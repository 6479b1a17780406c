"""Linear solver: conjugate gradients preconditioned by a geometric-multigrid V-cycle.

Each coarser operator is the tangent of its own mesh, frozen at this candidate's
own solution there. Smoother: Chebyshev of degree `DEGREE` over 3 x 3 block Jacobi;
the coarsest level is factored as a full matrix. The V-cycle runs in single precision.

A `PackedTangent` is prepared for many products: packed rows, block Jacobi, the plates' travel. Each
of its methods takes vectors of one right-hand side, (n, 4), or of `LANES`, (n, 4, LANES), in single
or double precision.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numba import njit
from scipy import linalg, sparse

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.kernels_and_threads import CONTRACTED, AnyFloatArray, Float32Array
from palpate.workers.mechanics.fem import krylov_solvers, sparse_products
from palpate.workers.mechanics.fem.krylov_solvers import Correction, Corrections
from palpate.workers.mechanics.fem.mesh_level import Level, Tangent


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


class PackedTangent:
    """Tangent of a level; the travel of its plates is eliminated by a rank-one term."""

    def __init__(self, level: Level, tangent: Tangent) -> None:
        g, n = level.model.graph, len(level.model.nodes)
        t = tangent
        self._matrix = g.start.view(np.uint32), g.neighbour.view(np.uint32), t.rows
        self._inverse = np.empty((n, 9), np.float32)
        sparse_products.invert_diagonal(g.start, g.diagonal, t.rows, level.free, self._inverse)
        self._index = t.contact_index.astype(np.uint32)
        self._coupling = np.ascontiguousarray(t.coupling) * level.free[t.contact_index]
        self._factor = 1 / t.plate_stiffness if t.plate_stiffness > 0 else 0.0
        self._free = np.zeros((n, 4), np.float32)
        self._free[:, :3] = level.free

    def only_free(self, x: Float32Array, y: Float32Array) -> None:
        """Set y to `x`, with held displacements and the pressures set to zero."""
        np.multiply(x, self._free if x.ndim == 2 else self._free[:, :, None], out=y)

    def multiply(self, x: AnyFloatArray, y: AnyFloatArray) -> None:
        """Set y to the tangent times x, and set the pressure of `x`."""
        sparse_products.set_pressure(*self._matrix, x)
        sparse_products.multiply(*self._matrix, x, y)
        self._add_travel(-self._factor, x, y)

    def apply_block_jacobi(self, x: Float32Array, z: Float32Array) -> None:
        """Set z to the block Jacobi product of x, both (n, 4)."""
        sparse_products.apply_diagonal(self._inverse, x, z)

    def set_pressure(self, x: AnyFloatArray) -> None:
        """Set the pressure of `x`, whose held displacements are zero."""
        sparse_products.set_pressure(*self._matrix, x)

    def subtract_product(self, x: Float32Array, r: Float32Array) -> None:
        """Subtract tangent times x from `r`; the pressure of `x` is set."""
        self._add_travel(self._factor, x, r)
        sparse_products.subtract_product(*self._matrix, x, r)

    def first_step(self, scale: np.float32, r: Float32Array, step: Float32Array) -> None:
        """Set the step to the scaled block Jacobi product of `r`, with its pressure."""
        sparse_products.first_step(*self._matrix, self._inverse, scale, r, step)

    def smoothing_sweep(
        self,
        momentum: np.float32,
        scale: np.float32,
        r: Float32Array,
        x: Float32Array,
        old: Float32Array,
        new: Float32Array,
        with_pressure: bool = True,
    ) -> None:
        """Take the step `old` and add the next one, `new`, to `x`; see `sparse_products`."""
        self._add_travel(self._factor, old, r)
        sparse_products.smoothing_sweep(
            *self._matrix, self._inverse, momentum, scale, r, x, old, new, with_pressure
        )

    def _add_travel(self, factor: float, x: AnyFloatArray, y: AnyFloatArray) -> None:
        """Add the rank-one term of the eliminated travel to `y`."""
        if factor:
            sparse_products.add_rank_one(self._index, self._coupling, factor, x, y)


DEGREE = 3
# The smoother treats the upper part of the spectrum, [lambda_max / RATIO, lambda_max].
RATIO = 12.0
# Power iterations for lambda_max, from noise and from an earlier eigenvector.
ROUNDS_FROM_NOISE, ROUNDS_FROM_ESTIMATE = 12, 3

Cholesky = tuple[FloatArray, bool]
"""Factor, and whether it is lower, as returned by `scipy.linalg.cho_factor`."""


class LinearSolver(Protocol):
    """Solver with one tangent."""

    @property
    def eigenvector(self) -> Float32Array | None:
        """Estimate of the stiffest mode, for the solver of the next tangent; shape (n, 4)."""

    def solve(self, b: FloatArray, tolerance: float) -> Correction:
        """Solve for the free displacements, shape (n, 3), to a relative residual."""

    def solve_many(self, b: FloatArray, tolerance: float) -> Corrections:
        """Solve for several right-hand sides, shape (k, n, 3), each to a relative error."""

    def precondition(self, b: Float32Array) -> Float32Array:
        """Solve approximately for one right-hand side, (n, 4), or for a block, (n, 4, LANES)."""

    def approximate(self, b: FloatArray) -> FloatArray:
        """Solve approximately for one right-hand side, (n, 4), as well as possible at low cost."""

    def multiply(self, x: FloatArray, y: FloatArray) -> None:
        """Set y to the tangent times x, and set the pressure of `x`."""


LinearSolverFactory = Callable[[Level, Tangent, Float32Array | None], LinearSolver]
"""Function that makes a solver from a tangent and an optional estimate of its stiffest mode."""


def linear_solver(
    level: Level,
    tangent: Tangent,
    coarser: Sequence[LinearSolver],
    eigenvector: Float32Array | None = None,
) -> LinearSolver:
    """Return a solver with this tangent, preconditioned by the coarser levels' solvers."""
    if not coarser:
        return CholeskySolver(level, tangent)
    return Multigrid(level, tangent, coarser[-1], eigenvector)


def solver_factory(coarser: Sequence[LinearSolver]) -> LinearSolverFactory:
    """Return the factory of a level's solvers, given the solvers of the coarser levels."""
    below = tuple(coarser)
    return lambda level, tangent, eigenvector: linear_solver(level, tangent, below, eigenvector)


class CholeskySolver:
    """Dense Cholesky factor of a small tangent, shifted until it is positive."""

    eigenvector: None = None

    def __init__(self, level: Level, tangent: Tangent) -> None:
        g = level.model.graph
        self._free = level.free.astype(np.float64)
        A = dense_matrix(g.start, g.neighbour, tangent.rows, level.free)
        if tangent.plate_stiffness > 0:
            c = (3 * tangent.contact_index[:, None] + np.arange(3)).ravel()
            a = tangent.coupling.ravel()
            A[np.ix_(c, c)] -= np.outer(a, a) / tangent.plate_stiffness
        self.shifted, self._factor = _cholesky(A)
        self._inverse: Float32Array | None = None
        self._packed = PackedTangent(level, tangent)

    def solve(self, b: FloatArray, tolerance: float = 0.0) -> Correction:
        """Solve directly; the tolerance is always met."""
        return Correction(self._solve(b), 1, 0.0, self.shifted)

    def solve_many(self, b: FloatArray, tolerance: float = 0.0) -> Corrections:
        """Solve directly; the tolerance is always met."""
        u = np.moveaxis(self._solve(np.moveaxis(b, 0, -1)), -1, 0)
        k = len(b)
        return Corrections(np.ascontiguousarray(u), np.ones(k, np.int64), np.zeros(k), self.shifted)

    def precondition(self, b: Float32Array) -> Float32Array:
        """Multiply by the inverse in single precision, computed at the first call."""
        if self._inverse is None:
            inverse = linalg.cho_solve(self._factor, np.diag(self._free.ravel()))
            inverse *= self._free.ravel()[:, None]
            self._inverse = np.asarray((inverse + inverse.T) / 2, dtype=np.float32)
        x = np.zeros_like(b)
        flat = b[:, :3].reshape((3 * len(b), *b.shape[2:]))
        x[:, :3] = (self._inverse @ flat).reshape((len(b), 3, *b.shape[2:]))
        return x

    def approximate(self, b: FloatArray) -> FloatArray:
        """Solve directly."""
        x = np.zeros_like(b)
        x[:, :3] = self._solve(b[:, :3])
        return x

    def multiply(self, x: FloatArray, y: FloatArray) -> None:
        """Set y to the tangent times x, and set the pressure of `x`."""
        self._packed.multiply(x, y)

    def _solve(self, b: FloatArray) -> FloatArray:
        """Solve for `b`, (n, 3) or (n, 3, k)."""
        free = self._free.reshape(b.shape[:2] + (1,) * (b.ndim - 2))
        flat = (b * free).reshape((3 * len(b), *b.shape[2:]))
        u = linalg.cho_solve(self._factor, flat, check_finite=False)
        return u.reshape(b.shape) * free


def _cholesky(A: FloatArray) -> tuple[bool, Cholesky]:
    """Factor `A`; the flag is True if it had to be shifted."""
    shift = 0.0
    scale = float(np.abs(np.diagonal(A)).mean())
    while True:
        try:
            shifted = A + shift * np.eye(len(A)) if shift else A
            return shift > 0, linalg.cho_factor(shifted, lower=True, check_finite=False)
        except linalg.LinAlgError:
            shift = max(4 * shift, 1e-3 * scale)


class Multigrid:
    """Conjugate gradients on one level, preconditioned through all coarser ones.

    Parameters
    ----------
    level : Level
    tangent : Tangent
    coarser : LinearSolver
        Solver of the next coarser level.
    eigenvector : ndarray of float32, shape (n, 4), optional
        Estimate from an earlier tangent: it hardly changes between Newton steps.
    """

    def __init__(
        self,
        level: Level,
        tangent: Tangent,
        coarser: LinearSolver,
        eigenvector: Float32Array | None = None,
    ) -> None:
        if level.model.transfer is None:
            raise ValueError("The coarsest level has no coarser one; use CholeskySolver.")
        self._packed = PackedTangent(level, tangent)
        self._transfer = level.model.transfer
        self._coarser = coarser
        self._work: dict[int, tuple[Float32Array, ...]] = {}
        largest, self.eigenvector = _largest_eigenvalue(level, self._packed, eigenvector)
        self._steps = _chebyshev(1.1 * largest)

    def solve(self, b: FloatArray, tolerance: float) -> Correction:
        """Solve by conjugate gradients, vectors in double precision."""
        return krylov_solvers.solve_by_cg(self, b, tolerance)

    def solve_many(self, b: FloatArray, tolerance: float) -> Corrections:
        """Solve for several right-hand sides, shape (k, n, 3), in blocks."""
        return krylov_solvers.solve_many_by_block_cg(self, b, tolerance)

    def multiply(self, x: FloatArray, y: FloatArray) -> None:
        """Set y to the tangent times x, for one right-hand side or a block."""
        self._packed.multiply(x, y)

    def precondition(self, b: Float32Array) -> Float32Array:
        """Run one symmetric V-cycle: equal smoothing before and after the coarser level.

        The result is valid until the next call.
        """
        A = self._packed
        x, r, step, other = self._work_vectors(b)
        A.only_free(b, r)
        A.first_step(self._steps[0][1], r, step)
        x[:] = step
        for momentum, scale in self._steps[1:]:
            A.smoothing_sweep(momentum, scale, r, x, step, other)
            step, other = other, step
        A.subtract_product(step, r)
        coarse = self._coarser.precondition(_product(self._transfer.restriction, r))
        A.only_free(_product(self._transfer.prolongation, coarse), step)
        A.set_pressure(step)
        x += step
        for number, (momentum, scale) in enumerate(self._steps, 1):
            A.smoothing_sweep(momentum, scale, r, x, step, other, number < len(self._steps))
            step, other = other, step
        return x

    def approximate(self, b: FloatArray) -> FloatArray:
        """Run one V-cycle, from and to double precision."""
        return self.precondition(b.astype(np.float32)).astype(np.float64)

    def _work_vectors(self, like: Float32Array) -> tuple[Float32Array, ...]:
        """Return four cached vectors: paging in fresh ones would cost more than a sweep."""
        if like.ndim not in self._work:
            self._work[like.ndim] = tuple(np.zeros_like(like) for _ in range(4))
        return self._work[like.ndim]


def _product(matrix: sparse.csr_matrix, x: Float32Array) -> Float32Array:
    """Return `matrix` times each column of `x`, (n, ...)."""
    return (matrix @ x.reshape(len(x), -1)).reshape((matrix.shape[0], *x.shape[1:]))


def _chebyshev(largest: float) -> list[tuple[np.float32, np.float32]]:
    """Return the momentum of each smoothing step, and its factor on the residual.

    Chebyshev iteration on [largest / RATIO, largest] (Adams, Brezina, Hu and
    Tuminaro 2003).
    """
    low = largest / RATIO
    centre, half = (largest + low) / 2, (largest - low) / 2
    sigma = centre / half
    rho = 1 / sigma
    steps = [(0.0, 1 / centre)]
    for _ in range(DEGREE - 1):
        following = 1 / (2 * sigma - rho)
        steps.append((following * rho, 2 * following / half))
        rho = following
    return [(np.float32(momentum), np.float32(scale)) for momentum, scale in steps]


def _largest_eigenvalue(
    level: Level, packed: PackedTangent, estimate: Float32Array | None
) -> tuple[float, Float32Array]:
    """Find the largest eigenvalue of block Jacobi times tangent, by power iteration.

    Without an `estimate` of the eigenvector, iteration starts from noise.

    Returns
    -------
    float
    ndarray of float32, shape (n, 4)
        Its eigenvector, of unit length.
    """
    if estimate is None:
        noise = np.random.default_rng(0).standard_normal(level.free.shape)
        v, rounds = np.zeros((len(noise), 4), np.float32), ROUNDS_FROM_NOISE
        v[:, :3] = noise * level.free
    else:
        # A product sets the pressure of its argument: the estimate is left unchanged.
        v, rounds = estimate.copy(), ROUNDS_FROM_ESTIMATE
    y, z = np.zeros_like(v), np.zeros_like(v)
    largest = 1.0
    for _ in range(rounds):
        packed.multiply(v, y)
        packed.apply_block_jacobi(y, z)
        length = float(np.linalg.norm(z))
        largest = length / float(np.linalg.norm(v[:, :3]))
        v = z / np.float32(length)
    return largest, v
