"""Linear solver: conjugate gradients preconditioned by a geometric-multigrid V-cycle.

Each coarser operator is the tangent of its own mesh, frozen at this candidate's
own solution there. Smoother: Chebyshev of degree `DEGREE` over 3 x 3 block Jacobi;
the coarsest level is factored. The V-cycle runs in single precision.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from scipy import linalg, sparse

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.linear import block_conjugate_gradients, conjugate_gradients
from palpate.workers.mechanics.fem.linear.conjugate_gradients import Correction, Corrections
from palpate.workers.mechanics.fem.linear.dense_tangent import dense_matrix
from palpate.workers.mechanics.fem.linear.level import Level, Tangent
from palpate.workers.mechanics.fem.linear.packed_tangent import PackedTangent
from palpate.workers.mechanics.fem.problem.array_types import Float32Array

__all__ = [
    "CholeskySolver",
    "Correction",
    "Corrections",
    "LinearSolver",
    "LinearSolverFactory",
    "Multigrid",
    "linear_solver",
    "solver_factory",
]

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
        return conjugate_gradients.solve(self, b, tolerance)

    def solve_many(self, b: FloatArray, tolerance: float) -> Corrections:
        """Solve for several right-hand sides, shape (k, n, 3), in blocks."""
        return block_conjugate_gradients.solve_many(self, b, tolerance)

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
