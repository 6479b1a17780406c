"""Gauss and Newton: the parameters of a hypothesis that explain the scans best."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.diagnosis.linear import Linearised
from workers.diagnosis.subject import Subject, Unknowns
from workers.diagnosis.views import Slope, View, derivatives, view
from workers.fem.solve import Equilibrium

MAX_ITERATIONS = 12
MAX_HALVINGS = 5
# A fall of minus twice the log posterior below this changes no verdict.
TOLERANCE = 0.05
# Longest step of a parameter in prior standard deviations.
LONGEST = 1.5


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its optimum.

    Parameters
    ----------
    unknowns : Unknowns
    z : ndarray, shape (p,)
        Logarithms of the constants, then the parameters of the effects.
    views : tuple of View
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
    views: tuple[View, ...]
    jacobian: FloatArray
    cost: float
    converged: bool
    iterations: int

    def values(self) -> dict[str, float]:
        """All parameters by name, constants themselves instead of their logarithms."""
        k = len(self.unknowns.free)
        values = self.unknowns.constants(self.z)
        rest = zip(self.unknowns.names[k:], self.z[k:], strict=True)
        return values | {n: float(v) for n, v in rest}

    def starts(self) -> list[Equilibrium]:
        """Where another fit may begin."""
        return [v.at for v in self.views]

    def linearised(self, subject: Subject) -> Linearised:
        """Residuals, derivatives and noise around the optimum."""
        u = self.unknowns
        return Linearised(
            residuals(subject, self.views),
            self.jacobian,
            u.sd,
            self.z - u.mean,
            subject.covariance_factor,
        )


def residuals(subject: Subject, views: Sequence[View]) -> FloatArray:
    """Of all scans, less what the mesh adds, shape (m,)."""
    return np.concatenate([v.residual for v in views]) - subject.bias


def fit(
    subject: Subject,
    unknowns: Unknowns,
    start: FloatArray,
    starts: Sequence[Equilibrium | None],
) -> Fit | None:
    """Find the most probable parameters.

    Parameters
    ----------
    start : ndarray, shape (p,)
        Where to begin.
    starts : sequence of Equilibrium
        Of each scan, near there; None to solve from rest.

    Returns
    -------
    Fit or None
        None if the simulation at the start does not converge.
    """
    z = np.clip(start, unknowns.lower, unknowns.upper)
    views = _views(subject, unknowns, z, starts)
    if views is None:
        return None
    cost = _cost(subject, unknowns, z, views)
    slopes: list[Slope] | None = None
    fall = np.inf
    for iteration in range(1, MAX_ITERATIONS + 1):
        slopes = _slopes(subject, unknowns, z, views, slopes)
        J = np.vstack([slope.columns for slope in slopes])
        step, expected = _step(subject, unknowns, z, views, J)
        if expected < TOLERANCE:
            return Fit(unknowns, z, views, J, cost, True, iteration)
        found = _descend(subject, unknowns, z, views, cost, step)
        if found is None and not all(slope.fresh for slope in slopes):
            slopes = None  # columns taken over from elsewhere may point uphill
            continue
        if found is None:
            return Fit(unknowns, z, views, J, cost, True, iteration)
        fall = cost - found[2]
        z, views, cost = found
        if fall < TOLERANCE:
            break
    slopes = _slopes(subject, unknowns, z, views, slopes)
    J = np.vstack([slope.columns for slope in slopes])
    return Fit(unknowns, z, views, J, cost, fall < TOLERANCE, iteration)


def _views(
    subject: Subject, unknowns: Unknowns, z: FloatArray, starts: Sequence[Equilibrium | None]
) -> tuple[View, ...] | None:
    found = []
    for scan, start in zip(subject.scans, starts, strict=True):
        one = view(subject, scan, unknowns, z, start)
        if one is None:
            return None
        found.append(one)
    return tuple(found)


def _slopes(
    subject: Subject,
    unknowns: Unknowns,
    z: FloatArray,
    views: Sequence[View],
    before: Sequence[Slope] | None,
) -> list[Slope]:
    known: Sequence[Slope | None] = before or [None] * len(views)
    rows = zip(subject.scans, views, known, strict=True)
    return [derivatives(subject, scan, unknowns, z, v, last) for scan, v, last in rows]


def _cost(subject: Subject, u: Unknowns, z: FloatArray, views: Sequence[View]) -> float:
    white = _whiten(subject, residuals(subject, views))
    return float(white @ white + (((z - u.mean) / u.sd) ** 2).sum())


def _whiten(subject: Subject, values: FloatArray) -> FloatArray:
    n = len(values)
    empty = Linearised(
        np.zeros(n), np.zeros((n, 0)), np.ones(0), np.zeros(0), subject.covariance_factor
    )
    return empty.whiten(values)


def _step(
    subject: Subject, u: Unknowns, z: FloatArray, views: Sequence[View], J: FloatArray
) -> tuple[FloatArray, float]:
    """The Gauss-Newton step, and by how much the cost should fall.

    Parameters at a bound that push outwards stay there.
    """
    A = _whiten(subject, J) * u.sd
    rho = _whiten(subject, residuals(subject, views))
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
    length = min(1.0, LONGEST / longest if longest else 1.0)
    return np.asarray(step * u.sd * length), float(-g @ step)


def _descend(
    subject: Subject,
    u: Unknowns,
    z: FloatArray,
    views: Sequence[View],
    cost: float,
    step: FloatArray,
) -> tuple[FloatArray, tuple[View, ...], float] | None:
    length = 1.0
    for _ in range(MAX_HALVINGS):
        trial = np.clip(z + length * step, u.lower, u.upper)
        found = _views(subject, u, trial, [v.at for v in views])
        if found is not None:
            cost_there = _cost(subject, u, trial, found)
            if cost_there < cost:
                return trial, found, cost_there
        length *= 0.4
    return None
