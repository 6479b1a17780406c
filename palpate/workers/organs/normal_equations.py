r"""Normal equations of a least-squares problem, from residuals and their derivatives.

With residuals r and derivatives J in units of their noise, and errors that many residuals have
in common, :math:`r = B b + e` with b of unit variance,

.. math:: c = \min_b \sum_i \rho(r_i - (B b)_i) + b'b, \qquad
          g = J' W e, \qquad H = J' W J - J' W B (B' W B + 1)^{-1} B' W J,

where :math:`\rho(e) = e^2` up to `HUBER` and linear beyond, and W its weights (P. J. Huber, Ann.
Math. Statist. 35 (1964) 73), so that points close to a second interface have less weight. b is
found by reweighting; the gradient of c in the parameters is 2 g.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray

# In standard deviations.
HUBER = 1.5
ROUNDS = 30


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The normal equations at given parameter values.

    Parameters
    ----------
    cost : float
    gradient : ndarray, shape (p,)
    hessian : ndarray, shape (p, p)
    residuals : int
    """

    cost: float
    gradient: FloatArray
    hessian: FloatArray
    residuals: int

    @property
    def noise(self) -> float:
        """Return the ratio of the residual variance to the expected one, at least 1."""
        return max(1.0, self.cost / max(1, self.residuals - len(self.gradient)))

    def part(self, index: Sequence[int]) -> "NormalEquations":
        """Return the equations of some of the parameters, with the others held."""
        hessian = self.hessian[np.ix_(index, index)]
        return NormalEquations(self.cost, self.gradient[index], hessian, self.residuals)


def normal_equations(
    r: FloatArray, jacobian: FloatArray, common: FloatArray, *, robust: bool
) -> NormalEquations:
    """Return the normal equations; see the top of the file.

    Parameters
    ----------
    r : ndarray, shape (m,)
    jacobian : ndarray, shape (m, p)
    common : ndarray, shape (m, q)
        B, in units of the standard deviations of b.
    robust : bool
        Whether large residuals count less.
    """
    b = np.zeros(common.shape[1])
    for _ in range(ROUNDS):
        weight = _weight(r - common @ b, robust)
        weighted = common.T * weight
        information = weighted @ common + np.eye(len(b))
        before, b = b, np.asarray(np.linalg.solve(information, weighted @ r), np.float64)
        if np.abs(b - before).max(initial=0.0) < 1e-9:
            break
    e = r - common @ b
    weight = _weight(e, robust)
    weighted = common.T * weight
    shared = weighted @ jacobian
    hessian = (jacobian.T * weight) @ jacobian
    hessian -= shared.T @ np.linalg.solve(weighted @ common + np.eye(len(b)), shared)
    return NormalEquations(
        cost=float(_loss(e, robust).sum() + b @ b),
        gradient=np.asarray(jacobian.T @ (weight * e)),
        hessian=(hessian + hessian.T) / 2,
        residuals=len(r),
    )


def _weight(e: FloatArray, robust: bool) -> FloatArray:
    if not robust:
        return np.ones_like(e)
    return HUBER / np.maximum(np.abs(e), HUBER)


def _loss(e: FloatArray, robust: bool) -> FloatArray:
    if not robust:
        return e**2
    size = np.abs(e)
    return np.where(size <= HUBER, size**2, HUBER * (2 * size - HUBER))
