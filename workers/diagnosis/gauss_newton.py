"""Gauss and Newton: the parameters of a hypothesis that explain the scans best."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.diagnosis.inverse_problem import InverseProblem, Unknowns
from workers.diagnosis.linearisation import Linearised
from workers.diagnosis.scan_prediction import (
    ComparedScan,
    PredictedScan,
    ScanJacobian,
    derivatives,
    predict_scan,
)
from workers.diagnosis.settings import SETTINGS
from workers.mechanics.fem.solve import Equilibrium


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its optimum.

    Parameters
    ----------
    unknowns : Unknowns
    z : ndarray, shape (p,)
        Logarithms of the constants, then the parameters of the effects.
    predictions : tuple of ComparedScan
        One for each scan.
    jacobian : ndarray, shape (m, p)
        Of the residuals of all scans.
    cost : float
        Minus twice the log posterior, up to a constant.
    converged : bool
    iterations : int
    """

    unknowns: Unknowns
    z: FloatArray
    predictions: tuple[ComparedScan, ...]
    jacobian: FloatArray
    cost: float
    converged: bool
    iterations: int

    def values(self) -> dict[str, float]:
        """Return all parameters by name, constants themselves instead of their logarithms."""
        k = len(self.unknowns.free)
        values = self.unknowns.constants(self.z)
        rest = zip(self.unknowns.names[k:], self.z[k:], strict=True)
        return values | {n: float(v) for n, v in rest}

    def linearised(self, inverse: InverseProblem) -> Linearised:
        """Return residuals, derivatives and noise around the optimum."""
        u = self.unknowns
        return Linearised(
            residuals(inverse, self.predictions),
            self.jacobian,
            u.sd,
            self.z - u.mean,
            inverse.covariance_factor,
        )


@dataclass(frozen=True, eq=False)
class SolvedFit(Fit):
    """A fit with the equilibria of its scans, from which others can be solved."""

    predictions: tuple[PredictedScan, ...]

    def starts(self) -> list[Equilibrium]:
        """Return where another fit may begin."""
        return [one.at for one in self.predictions]


def residuals(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> FloatArray:
    """Return residuals of all scans, less what the mesh adds, shape (m,)."""
    return np.concatenate([v.residual for v in predictions]) - inverse.bias


def fit(
    inverse: InverseProblem,
    unknowns: Unknowns,
    start: FloatArray,
    starts: Sequence[Equilibrium | None],
) -> SolvedFit | None:
    """Find the most probable parameters.

    Parameters
    ----------
    start : ndarray, shape (p,)
        Where to begin.
    starts : sequence of Equilibrium
        Of each scan, near there; None to solve from rest.

    Returns
    -------
    SolvedFit or None
        None if the simulation at the start does not converge.
    """
    z = np.clip(start, unknowns.lower, unknowns.upper)
    predictions = _predict_scans(inverse, unknowns, z, starts)
    if predictions is None:
        return None
    cost = _cost(inverse, unknowns, z, predictions)
    jacobians: list[ScanJacobian] | None = None
    fall = np.inf
    for iteration in range(1, SETTINGS.fit.max_iterations + 1):
        jacobians = _jacobians(inverse, unknowns, z, predictions, jacobians)
        J = np.vstack([jacobian.columns for jacobian in jacobians])
        step, expected = _step(inverse, unknowns, z, predictions, J)
        if expected < SETTINGS.fit.tolerance:
            return SolvedFit(unknowns, z, predictions, J, cost, True, iteration)
        found = _descend(inverse, unknowns, z, predictions, cost, step)
        if found is None and not all(jacobian.fresh for jacobian in jacobians):
            jacobians = None  # columns taken over from elsewhere may point uphill
            continue
        if found is None:
            return SolvedFit(unknowns, z, predictions, J, cost, True, iteration)
        fall = cost - found[2]
        z, predictions, cost = found
        if fall < SETTINGS.fit.tolerance:
            break
    jacobians = _jacobians(inverse, unknowns, z, predictions, jacobians)
    J = np.vstack([jacobian.columns for jacobian in jacobians])
    return SolvedFit(unknowns, z, predictions, J, cost, fall < SETTINGS.fit.tolerance, iteration)


def _predict_scans(
    inverse: InverseProblem, unknowns: Unknowns, z: FloatArray, starts: Sequence[Equilibrium | None]
) -> tuple[PredictedScan, ...] | None:
    found = []
    for scan, start in zip(inverse.scans, starts, strict=True):
        one = predict_scan(inverse, scan, unknowns, z, start)
        if one is None:
            return None
        found.append(one)
    return tuple(found)


def _jacobians(
    inverse: InverseProblem,
    unknowns: Unknowns,
    z: FloatArray,
    predictions: Sequence[PredictedScan],
    before: Sequence[ScanJacobian] | None,
) -> list[ScanJacobian]:
    known: Sequence[ScanJacobian | None] = before or [None] * len(predictions)
    rows = zip(inverse.scans, predictions, known, strict=True)
    return [derivatives(inverse, scan, unknowns, z, v, last) for scan, v, last in rows]


def _cost(
    inverse: InverseProblem, u: Unknowns, z: FloatArray, predictions: Sequence[PredictedScan]
) -> float:
    white = _whiten(inverse, residuals(inverse, predictions))
    return float(white @ white + (((z - u.mean) / u.sd) ** 2).sum())


def _whiten(inverse: InverseProblem, values: FloatArray) -> FloatArray:
    n = len(values)
    empty = Linearised(
        np.zeros(n), np.zeros((n, 0)), np.ones(0), np.zeros(0), inverse.covariance_factor
    )
    return empty.whiten(values)


def _step(
    inverse: InverseProblem,
    u: Unknowns,
    z: FloatArray,
    predictions: Sequence[PredictedScan],
    J: FloatArray,
) -> tuple[FloatArray, float]:
    """Return the Gauss-Newton step, and by how much the cost should fall.

    Parameters at a bound that push outwards stay there.
    """
    A = _whiten(inverse, J) * u.sd
    rho = _whiten(inverse, residuals(inverse, predictions))
    held = np.zeros(len(z), bool)
    while True:
        g = A.T @ rho + (z - u.mean) / u.sd
        H = A.T @ A + np.eye(len(z))
        go = np.flatnonzero(~held)
        step = np.zeros(len(z))
        step[go] = -np.linalg.solve(H[np.ix_(go, go)], g[go])
        blocked = ((z <= u.lower) & (step < 0)) | ((z >= u.upper) & (step > 0))
        if not (blocked & ~held).any():
            break
        held |= blocked
    longest = float(np.abs(step).max(initial=0.0))
    length = min(1.0, SETTINGS.fit.longest_step / longest if longest else 1.0)
    return np.asarray(step * u.sd * length), float(-g @ step)


def _descend(
    inverse: InverseProblem,
    u: Unknowns,
    z: FloatArray,
    predictions: Sequence[PredictedScan],
    cost: float,
    step: FloatArray,
) -> tuple[FloatArray, tuple[PredictedScan, ...], float] | None:
    length = 1.0
    for _ in range(SETTINGS.fit.max_halvings):
        trial = np.clip(z + length * step, u.lower, u.upper)
        found = _predict_scans(inverse, u, trial, [v.at for v in predictions])
        if found is not None:
            cost_there = _cost(inverse, u, trial, found)
            if cost_there < cost:
                return trial, found, cost_there
        length *= SETTINGS.fit.shortening
    return None
