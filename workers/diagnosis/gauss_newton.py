"""Gauss and Newton: the parameters of a hypothesis that explain the scans best."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.diagnosis.inverse_problem import InverseProblem, Scan, Unknowns
from workers.diagnosis.linearisation import Linearised
from workers.diagnosis.noise_model import LinearHypothesis
from workers.diagnosis.scan_prediction import (
    ComparedScan,
    Pose,
    PredictedScan,
    ScanJacobian,
    compare_with_scan,
    derivatives,
    predict_scan,
)
from workers.diagnosis.settings import SETTINGS
from workers.mechanics.fem.solve import Equilibrium
from workers.scan_threads import Each


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
        """Return residuals, derivatives and noise around the optimum; poses are in the noise."""
        u = self.unknowns
        return Linearised(
            residuals(inverse, self.predictions),
            self.jacobian,
            u.sd,
            self.z - u.mean,
            inverse.covariance_factor,
        )

    def linearised_with_poses(self, inverse: InverseProblem) -> Linearised:
        """Return the same with poses and drawing as free parameters after the others.

        A gap is what they leave: where a scan lies is no fault of the model.
        """
        u, nuisances = self.unknowns, inverse.nuisances
        q = nuisances.shape[1]
        return Linearised(
            residuals(inverse, self.predictions),
            np.hstack([self.jacobian, nuisances]),
            np.append(u.sd, np.ones(q)),
            np.append(self.z - u.mean, np.zeros(q)),
            inverse.scatter_factor,
        )

    def hypothesis(self, inverse: InverseProblem) -> LinearHypothesis:
        """Return the same for `workers.diagnosis.noise_model.NoiseModel`."""
        u = self.unknowns
        return LinearHypothesis(
            residuals(inverse, self.predictions),
            self.jacobian * u.sd,
            (self.z - u.mean) / u.sd,
            u.one_sided,
        )


@dataclass(frozen=True, eq=False)
class SolvedFit(Fit):
    """A fit with the equilibria of its scans, from which others can be solved."""

    predictions: tuple[PredictedScan, ...]

    def starts(self) -> list[Equilibrium]:
        """Return where another fit may begin."""
        return [one.at for one in self.predictions]

    def poses(self) -> list[Pose | None]:
        """Return where the scans lie."""
        return [one.pose for one in self.predictions]


def residuals(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> FloatArray:
    """Return residuals of all scans, less what the mesh adds, shape (m,)."""
    return np.concatenate([v.residual for v in predictions]) - inverse.bias


def fit(
    inverse: InverseProblem,
    unknowns: Unknowns,
    start: FloatArray,
    starts: Sequence[Equilibrium | None],
    poses: Sequence[Pose | None] | None = None,
    each: Each = map,
) -> SolvedFit | None:
    """Find the most probable parameters.

    Parameters
    ----------
    start : ndarray, shape (p,)
        Where to begin.
    starts : sequence of Equilibrium
        Of each scan, near there; None to solve from rest.
    poses : sequence of Pose, optional
        Where the scans lie to begin with; as their headers say.
    each : callable
        Calls a function with every scan, as `map` does; maybe several at a time.

    Returns
    -------
    SolvedFit or None
        None if the simulation at the start does not converge.
    """
    z = np.clip(start, unknowns.lower, unknowns.upper)
    nowhere: Sequence[Pose | None] = poses or [None] * len(starts)
    predictions = _predict_scans(inverse, unknowns, z, starts, nowhere, each)
    if predictions is None:
        return None
    cost = _cost(inverse, unknowns, z, predictions)
    jacobians: list[ScanJacobian] | None = None
    fall = np.inf
    for iteration in range(1, SETTINGS.fit.max_iterations + 1):
        jacobians = _jacobians(inverse, unknowns, z, predictions, jacobians, each)
        J = np.vstack([jacobian.columns for jacobian in jacobians])
        step, expected = _step(inverse, unknowns, z, predictions, J)
        if expected < SETTINGS.fit.tolerance:
            return SolvedFit(unknowns, z, predictions, J, cost, True, iteration)
        found = _descend(inverse, unknowns, z, predictions, cost, step, each)
        if found is None and not all(jacobian.fresh for jacobian in jacobians):
            jacobians = None  # columns taken over from elsewhere may point uphill
            continue
        if found is None:
            at_rest = expected < SETTINGS.fit.at_rest
            return SolvedFit(unknowns, z, predictions, J, cost, at_rest, iteration)
        fall = cost - found[2]
        z, predictions, cost = found
        if fall < SETTINGS.fit.tolerance:
            break
    jacobians = _jacobians(inverse, unknowns, z, predictions, jacobians, each)
    J = np.vstack([jacobian.columns for jacobian in jacobians])
    return SolvedFit(unknowns, z, predictions, J, cost, fall < SETTINGS.fit.tolerance, iteration)


def _predict_scans(
    inverse: InverseProblem,
    unknowns: Unknowns,
    z: FloatArray,
    starts: Sequence[Equilibrium | None],
    poses: Sequence[Pose | None],
    each: Each,
) -> tuple[PredictedScan, ...] | None:
    def predicted(scan: Scan, start: Equilibrium | None, pose: Pose | None) -> PredictedScan | None:
        return predict_scan(inverse, scan, unknowns, z, start, pose)

    found = []
    for one in each(predicted, inverse.scans, starts, poses):
        if one is None:
            return None
        found.append(one)
    return registered(inverse, unknowns, z, found)


def registered(
    inverse: InverseProblem, unknowns: Unknowns, z: FloatArray, found: Sequence[PredictedScan]
) -> tuple[PredictedScan, ...]:
    """Compare with the scans where the residuals say that they lie.

    A cost belongs to parameters only where this has settled: off the interface it is too low.
    """
    found = tuple(found)
    if not inverse.has_poses:
        return found
    settings, k = SETTINGS.pose, len(inverse.points)
    sd = np.repeat(inverse.pose_sd, 3)
    N = inverse.nuisances[:, : len(sd) * len(found)]
    white_N = _whiten(inverse, N)
    before = np.zeros(N.shape[1])
    for one, rows in zip(found, _split(before, len(found)), strict=True):
        if one.pose is not None:
            rows[:] = one.pose.motion / np.where(sd > 0, sd, 1.0)
    for _ in range(settings.registrations):
        after = white_N.T @ _whiten(inverse, residuals(inverse, found))
        if np.abs(after - before).max() < settings.settled:
            break
        poses = zip(_split(after, len(found)), (N @ after).reshape(-1, k), strict=True)
        found = tuple(
            compare_with_scan(inverse, scan, unknowns, z, one.at, Pose(sd * own, along))
            for scan, one, (own, along) in zip(inverse.scans, found, poses, strict=True)
        )
        before = after
    return found


def _split(values: FloatArray, parts: int) -> FloatArray:
    """Return a view with a row for each scan."""
    return values.reshape(parts, -1)


def _jacobians(
    inverse: InverseProblem,
    unknowns: Unknowns,
    z: FloatArray,
    predictions: Sequence[PredictedScan],
    before: Sequence[ScanJacobian] | None,
    each: Each,
) -> list[ScanJacobian]:
    known: Sequence[ScanJacobian | None] = before or [None] * len(predictions)

    def differentiated(scan: Scan, at: PredictedScan, last: ScanJacobian | None) -> ScanJacobian:
        return derivatives(inverse, scan, unknowns, z, at, last)

    return list(each(differentiated, inverse.scans, predictions, known))


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


def _places(
    predictions: Sequence[PredictedScan],
) -> tuple[list[Equilibrium | None], list[Pose | None]]:
    """Return from where the next trial of a line search is solved and compared."""
    return [v.at for v in predictions], [v.pose for v in predictions]


def _descend(
    inverse: InverseProblem,
    u: Unknowns,
    z: FloatArray,
    predictions: Sequence[PredictedScan],
    cost: float,
    step: FloatArray,
    each: Each,
) -> tuple[FloatArray, tuple[PredictedScan, ...], float] | None:
    length = 1.0
    for _ in range(SETTINGS.fit.max_halvings):
        trial = np.clip(z + length * step, u.lower, u.upper)
        found = _predict_scans(inverse, u, trial, *_places(predictions), each)
        if found is not None:
            cost_there = _cost(inverse, u, trial, found)
            if cost_there < cost:
                return trial, found, cost_there
        length *= SETTINGS.fit.shortening
    return None
