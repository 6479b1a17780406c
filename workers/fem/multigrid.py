"""The linear solver: conjugate gradients with one geometric-multigrid V-cycle.

Each coarser operator is the tangent of its own mesh, frozen at this candidate's
own solution there. Smoother: Chebyshev of degree `DEGREE` over 3 x 3 block Jacobi;
the coarsest level is factored. The V-cycle runs in single precision.
"""

from typing import Any, Protocol

import numpy as np
from scipy import linalg

from storage.values import FloatArray
from workers.fem import conjugate, operators
from workers.fem.conjugate import Correction, Corrections
from workers.fem.kernels import Float32Array
from workers.fem.level import Level, Tangent
from workers.fem.packed import Packed

__all__ = ["Correction", "Corrections", "Factored", "LinearSolver", "Multigrid"]

DEGREE = 3
# The smoother treats the upper part of the spectrum, [lambda_max / RATIO, lambda_max].
RATIO = 12.0


class LinearSolver(Protocol):
    """Solves with one tangent."""

    def solve(self, b: FloatArray, tolerance: float) -> Correction:
        """Solve for the free displacements, shape (n, 3), to a relative residual."""

    def solve_many(self, b: FloatArray, tolerance: float) -> Corrections:
        """Solve for several right-hand sides, shape (k, n, 3), each to a relative error."""

    def precondition(self, b: Float32Array) -> Float32Array:
        """Solve roughly for one right-hand side, (n, 4), or for a block, (n, 4, LANES)."""


class Factored:
    """Dense Cholesky factor of a small tangent, shifted until it is positive."""

    def __init__(self, level: Level, tangent: Tangent) -> None:
        g = level.model.graph
        self._free = level.free.astype(np.float64)
        A = operators.dense(g.start, g.neighbour, tangent.rows, level.free)
        if tangent.plate_stiffness > 0:
            c = (3 * tangent.pads[:, None] + np.arange(3)).ravel()
            a = tangent.coupling.ravel()
            A[np.ix_(c, c)] -= np.outer(a, a) / tangent.plate_stiffness
        self.shifted, self._factor = _cholesky(A)
        self._inverse: Float32Array | None = None

    def solve(self, b: FloatArray, tolerance: float = 0.0) -> Correction:
        """Solve directly; the tolerance is always met."""
        return Correction(self._solve(b), 1, 0.0, self.shifted)

    def solve_many(self, b: FloatArray, tolerance: float = 0.0) -> Corrections:
        """Solve directly; the tolerance is always met."""
        u = np.moveaxis(self._solve(np.moveaxis(b, 0, -1)), -1, 0)
        k = len(b)
        return Corrections(np.ascontiguousarray(u), np.ones(k, np.int64), np.zeros(k), self.shifted)

    def precondition(self, b: Float32Array) -> Float32Array:
        """Multiply with the inverse in single precision; it is made at the first call."""
        if self._inverse is None:
            inverse = linalg.cho_solve(self._factor, np.diag(self._free.ravel()))
            inverse *= self._free.ravel()[:, None]
            self._inverse = np.asarray((inverse + inverse.T) / 2, dtype=np.float32)
        x = np.zeros_like(b)
        flat = b[:, :3].reshape((3 * len(b), *b.shape[2:]))
        x[:, :3] = (self._inverse @ flat).reshape((len(b), 3, *b.shape[2:]))
        return x

    def _solve(self, b: FloatArray) -> FloatArray:
        """Solve for `b`, (n, 3) or (n, 3, k)."""
        free = self._free.reshape(b.shape[:2] + (1,) * (b.ndim - 2))
        flat = (b * free).reshape((3 * len(b), *b.shape[2:]))
        u = linalg.cho_solve(self._factor, flat, check_finite=False)
        return u.reshape(b.shape) * free


def _cholesky(A: FloatArray) -> tuple[bool, Any]:
    shift = 0.0
    scale = float(np.abs(np.diagonal(A)).mean())
    while True:
        try:
            shifted = A + shift * np.eye(len(A)) if shift else A
            return shift > 0, linalg.cho_factor(shifted, lower=True, check_finite=False)
        except linalg.LinAlgError:
            shift = max(4 * shift, 1e-3 * scale)


class Multigrid:
    """Conjugate gradients on one level, preconditioned through all coarser ones."""

    def __init__(self, level: Level, tangent: Tangent, coarser: LinearSolver) -> None:
        if level.model.transfer is None:
            raise ValueError("The coarsest level has nowhere to go; factor it.")
        self._packed = Packed(level, tangent)
        self._transfer = level.model.transfer
        self._coarser = coarser
        self._rooms: dict[int, tuple[Float32Array, ...]] = {}
        self._steps = _chebyshev(1.1 * _largest_eigenvalue(level, self._packed))

    def solve(self, b: FloatArray, tolerance: float) -> Correction:
        """Solve by conjugate gradients, vectors in double precision."""
        return conjugate.solve(self, b, tolerance)

    def solve_many(self, b: FloatArray, tolerance: float) -> Corrections:
        """Solve for several right-hand sides, shape (k, n, 3), that travel together."""
        return conjugate.solve_many(self, b, tolerance)

    def apply(self, x: FloatArray, y: FloatArray) -> None:
        """y = tangent times x, of one right-hand side or a block."""
        self._packed.apply(x, y)

    def precondition(self, b: Float32Array) -> Float32Array:
        """One V-cycle, symmetric: as much smoothing after as before the coarser level.

        The answer is good until the next call.
        """
        A = self._packed
        x, r, step, other = self._room(b)
        A.only_free(b, r)
        A.first_step(self._steps[0][1], r, step)
        x[:] = step
        for keep, scale in self._steps[1:]:
            A.sweep(keep, scale, r, x, step, other)
            step, other = other, step
        A.subtract(step, r)
        coarse = self._coarser.precondition(_transferred(self._transfer.up, r))
        A.only_free(_transferred(self._transfer.down, coarse), step)
        A.pressurise(step)
        x += step
        for number, (keep, scale) in enumerate(self._steps, 1):
            A.sweep(keep, scale, r, x, step, other, number < len(self._steps))
            step, other = other, step
        return x

    def _room(self, like: Float32Array) -> tuple[Float32Array, ...]:
        """Four vectors, kept: fresh ones would cost more than a sweep to page in."""
        if like.ndim not in self._rooms:
            self._rooms[like.ndim] = tuple(np.zeros_like(like) for _ in range(4))
        return self._rooms[like.ndim]


def _transferred(matrix: Any, x: Float32Array) -> Float32Array:
    return (matrix @ x.reshape(len(x), -1)).reshape((matrix.shape[0], *x.shape[1:]))


def _chebyshev(largest: float) -> list[tuple[np.float32, np.float32]]:
    """What each step of the smoother keeps of the last, and its share of the residual.

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
    return [(np.float32(keep), np.float32(scale)) for keep, scale in steps]


def _largest_eigenvalue(level: Level, packed: Packed) -> float:
    """Largest eigenvalue of block Jacobi times tangent, by power iteration.

    The first tangent of a level starts from noise, later ones from the
    eigenvector found before: it hardly turns between Newton steps.
    """
    v, rounds = level.stiffest_mode, 3
    if v is None:
        noise = np.random.default_rng(0).standard_normal(level.free.shape)
        v, rounds = np.zeros((len(noise), 4), np.float32), 12
        v[:, :3] = noise * level.free
    y, z = np.zeros_like(v), np.zeros_like(v)
    largest = 1.0
    for _ in range(rounds):
        packed.apply(v, y)
        packed.relax(y, z)
        length = float(np.linalg.norm(z))
        largest = length / float(np.linalg.norm(v[:, :3]))
        v = z / np.float32(length)
    level.stiffest_mode = v
    return largest
