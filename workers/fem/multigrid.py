"""The linear solver: conjugate gradients with one geometric-multigrid V-cycle.

Each coarser operator is the tangent of its own mesh, frozen at this candidate's
own solution there. Smoother: Chebyshev of degree 3 over 3 x 3 block Jacobi; the
coarsest level is factored. The V-cycle runs in single precision.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy import linalg

from storage.values import FloatArray
from workers.fem import operators
from workers.fem.kernels import Float32Array
from workers.fem.level import Level, Tangent

DEGREE = 3
# The smoother treats the upper part of the spectrum, [lambda_max / RATIO, lambda_max].
RATIO = 12.0
MAX_ITERATIONS = 120


@dataclass(frozen=True, eq=False)
class Correction:
    """A solution of the linear system, and how it was found.

    ``negative`` tells that a direction of negative curvature ended the iteration.
    """

    u: FloatArray
    iterations: int
    negative: bool


class LinearSolver(Protocol):
    """Solves with one tangent."""

    def solve(self, b: FloatArray, tolerance: float) -> Correction:
        """Solve for the free displacements, shape (n, 3), to a relative residual."""

    def precondition(self, b: Float32Array) -> Float32Array:
        """Solve roughly."""


class Factored:
    """Dense Cholesky factor of a small tangent, shifted until it is positive."""

    def __init__(self, level: Level, tangent: Tangent) -> None:
        g = level.model.graph
        self._free = level.free
        A = operators.dense(g.start, g.neighbour, tangent.K, tangent.B, tangent.D, level.free)
        if tangent.plate_stiffness > 0:
            c = (3 * tangent.pads[:, None] + np.arange(3)).ravel()
            a = tangent.coupling.ravel()
            A[np.ix_(c, c)] -= np.outer(a, a) / tangent.plate_stiffness
        self.shifted, self._factor = _cholesky(A)

    def solve(self, b: FloatArray, tolerance: float = 0.0) -> Correction:
        """Solve directly; the tolerance is always met."""
        u = linalg.cho_solve(self._factor, b.ravel(), check_finite=False).reshape(b.shape)
        return Correction(u * self._free, 1, self.shifted)

    def precondition(self, b: Float32Array) -> Float32Array:
        """Solve directly."""
        return self.solve(b.astype(np.float64)).u.astype(np.float32)


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
        self._level, self._t, self._coarser = level, tangent, coarser
        self._transfer = level.model.transfer
        g, n = level.model.graph, len(level.model.nodes)
        self._D32 = tangent.D.astype(np.float32)
        self._coupling32 = tangent.coupling.astype(np.float32)
        self._inverse = np.empty((n, 9), np.float32)
        operators.invert_diagonal(
            g.start,
            g.neighbour,
            g.diagonal,
            tangent.K,
            tangent.B,
            tangent.D,
            level.free,
            self._inverse,
        )
        self._scratch32 = np.empty(n, np.float32)
        self._scratch64 = np.empty(n)
        self._largest = 1.1 * self._power_iteration()

    def solve(self, b: FloatArray, tolerance: float) -> Correction:
        """Flexible conjugate gradients (Polak-Ribiere form), vectors in double precision."""
        x, r, y = np.zeros_like(b), b.copy(), np.empty_like(b)
        norm = float(np.linalg.norm(b))
        if norm == 0:
            return Correction(x, 0, False)
        z = self.precondition(r.astype(np.float32)).astype(np.float64)
        p, rz = z, float(np.vdot(r, z))
        for iteration in range(1, MAX_ITERATIONS + 1):
            self._multiply(p, y)
            curvature = float(np.vdot(p, y))
            if curvature <= 0 or rz <= 0:
                return Correction(p.copy() if iteration == 1 else x, iteration, True)
            alpha = rz / curvature
            x += alpha * p
            previous, r = r, r - alpha * y
            if float(np.linalg.norm(r)) < tolerance * norm:
                return Correction(x, iteration, False)
            z = self.precondition(r.astype(np.float32)).astype(np.float64)
            beta = float(np.vdot(r - previous, z)) / rz
            rz = float(np.vdot(r, z))
            p = z + beta * p
        return Correction(x, MAX_ITERATIONS, False)

    def precondition(self, b: Float32Array) -> Float32Array:
        """One V-cycle."""
        b = b * self._level.free
        x = np.zeros_like(b)
        y = np.empty_like(b)
        self._smooth(b, x, from_zero=True)
        self._multiply32(x, y)
        coarse = self._coarser.precondition(self._transfer.up @ (b - y))
        x += (self._transfer.down @ coarse) * self._level.free
        self._smooth(b, x, from_zero=False)
        return x

    def _multiply(self, x: FloatArray, y: FloatArray) -> None:
        g, t = self._level.model.graph, self._t
        operators.multiply(
            g.start, g.neighbour, t.K, t.B, t.D, self._level.free, x, self._scratch64, y
        )
        operators.subtract_rank_one(t.pads, t.coupling, t.plate_stiffness, x, y)

    def _multiply32(self, x: Float32Array, y: Float32Array) -> None:
        g, t = self._level.model.graph, self._t
        operators.multiply(
            g.start, g.neighbour, t.K, t.B, self._D32, self._level.free, x, self._scratch32, y
        )
        operators.subtract_rank_one(t.pads, self._coupling32, np.float32(t.plate_stiffness), x, y)

    def _smooth(self, b: Float32Array, x: Float32Array, *, from_zero: bool) -> None:
        """Chebyshev iteration for the upper spectrum (Adams et al. 2003), x in place."""
        high = self._largest
        low = high / RATIO
        centre, half = np.float32((high + low) / 2), np.float32((high - low) / 2)
        y, z = np.empty_like(b), np.empty_like(b)
        r = b.copy()
        if not from_zero:
            self._multiply32(x, y)
            r -= y
        operators.apply_diagonal(self._inverse, r, z)
        step = z / centre
        x += step
        sigma = centre / half
        rho = 1 / sigma
        for _ in range(DEGREE - 1):
            self._multiply32(step, y)
            r -= y
            operators.apply_diagonal(self._inverse, r, z)
            rho_next = 1 / (2 * sigma - rho)
            step = (rho_next * rho) * step + (2 * rho_next / half) * z
            rho = rho_next
            x += step

    def _power_iteration(self) -> float:
        """Largest eigenvalue of inverse-diagonal times tangent.

        The first tangent of a level starts from noise, later ones from the
        eigenvector found before: it hardly turns between Newton steps.
        """
        level = self._level
        v, rounds = level.stiffest_mode, 3
        if v is None:
            noise = np.random.default_rng(0).standard_normal(level.free.shape)
            v, rounds = (noise * level.free).astype(np.float32), 12
        y, z = np.empty_like(v), np.empty_like(v)
        largest = 1.0
        for _ in range(rounds):
            self._multiply32(v, y)
            operators.apply_diagonal(self._inverse, y, z)
            length = float(np.linalg.norm(z))
            largest = length / float(np.linalg.norm(v))
            v = z / np.float32(length)
        level.stiffest_mode = v
        return largest
