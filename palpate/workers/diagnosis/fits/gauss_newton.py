r"""Gauss-Newton fit of a hypothesis's parameters to the scans.

The Hessian of half a sum of squares is :math:`A^T A + \sum_i r_i \nabla^2 r_i`. The second part,
which the Gauss-Newton method neglects, is negligible if the residuals are small or nearly linear. A
localised effect moves the points nonlinearly, and noise is never small: a step based on the first
part alone then achieves a tenth of the expected decrease, and a line search crawls. The second part
is estimated from secants as in NL2SOL (J. E. Dennis, D. M. Gay and R. E. Welsch, ACM Trans. Math.
Softw. 7 (1981) 348), and used for the next step if it would have predicted the last step better.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.laplace_evidence import log_evidence
from palpate.workers.diagnosis.linearisation import Linearised, factored
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem, Scan, Unknowns
from palpate.workers.diagnosis.problem.scan_prediction import (
    ComparedScan,
    PosedNoise,
    PredictedScan,
    ScanJacobian,
    derivatives,
    poses_of,
    predict_scan,
    registered,
    residuals,
)
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium

SMALLEST_CURVATURE = 1e-12

Listener = Callable[[int], object]
"""Receives the number of an iteration when it begins."""

_listener: ContextVar[Listener | None] = ContextVar("listener of fits", default=None)


@contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Tell a listener of every iteration of the fits in this block and thread."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@dataclass(frozen=True, eq=False)
class LocalModel:
    """Quadratic model of half the cost, with parameters in prior standard deviations.

    Parameters
    ----------
    columns : ndarray, shape (m, p)
        Derivatives of the whitened residuals.
    residual : ndarray, shape (m,)
        Whitened residuals, without the part that poses explain.
    gradient : ndarray, shape (p,)
        Gradient, including the prior.
    curvature : ndarray, shape (p, p)
        Gauss-Newton curvature, including the prior.
    """

    columns: FloatArray
    residual: FloatArray
    gradient: FloatArray
    curvature: FloatArray

    def fall(self, step: FloatArray, missing: FloatArray | None = None) -> float:
        """Return the expected decrease in cost over a step, (p,)."""
        bent = self.curvature if missing is None else self.curvature + missing
        return float(-2.0 * self.gradient @ step - step @ bent @ step)


@dataclass(frozen=True, eq=False)
class SecantCurvature:
    """The neglected curvature, estimated from the steps so far.

    Parameters
    ----------
    missing : ndarray, shape (p, p)
    is_used : bool
        Whether the next step takes the estimate into account.
    last : LocalModel, optional
        The model at the start of the last step.
    step : ndarray, shape (p,), optional
        The last step.
    """

    missing: FloatArray
    is_used: bool = False
    last: LocalModel | None = None
    step: FloatArray | None = None

    @classmethod
    def unknown(cls, parameters: int) -> "SecantCurvature":
        """Return the initial estimate, for a fit that has not taken a step."""
        return cls(np.zeros((parameters, parameters)))

    @property
    def is_known(self) -> bool:
        """Whether any step has contributed to the estimate."""
        return bool(self.missing.any())

    def used(self) -> "SecantCurvature":
        """Return the estimate, to be used in the next step."""
        return replace(self, is_used=True)

    def stepped(self, model: LocalModel, step: FloatArray, fall: float) -> "SecantCurvature":
        """Return the estimate after recording a step from a model, given the decrease in cost."""
        without, with_it = model.fall(step), model.fall(step, self.missing)
        better = self.is_known and abs(fall - with_it) < abs(fall - without)
        return SecantCurvature(self.missing, better, model, step)

    def renewed(self, now: LocalModel) -> "SecantCurvature":
        """Return the estimate updated at the end of the last step."""
        if self.last is None or self.step is None:
            return self
        s, bent = self.step, self.missing
        y = now.gradient - self.last.gradient
        wanted = now.columns.T @ now.residual - self.last.columns.T @ now.residual
        along = float(s @ bent @ s)
        if along:
            bent = bent * min(1.0, abs(float(s @ wanted)) / abs(along))
        ys = float(y @ s)
        if ys > SMALLEST_CURVATURE * float(np.linalg.norm(y) * np.linalg.norm(s)):
            off = wanted - bent @ s
            bent = bent + (np.outer(off, y) + np.outer(y, off)) / ys
            bent = bent - float(s @ off) * np.outer(y, y) / ys**2
        return SecantCurvature(bent, self.is_used)

    def forgotten(self) -> "SecantCurvature":
        """Return the estimate without the last step, if the derivatives at its end are unknown."""
        return replace(self, last=None, step=None)

    def curvature(self, model: LocalModel) -> FloatArray:
        """Return the curvature for the next step, positive definite, shape (p, p)."""
        if not self.is_used:
            return model.curvature
        bent = model.curvature + self.missing
        lacks = SETTINGS.fit.least_curvature - float(np.linalg.eigvalsh(bent)[0])
        return bent + max(lacks, 0.0) * np.eye(len(bent))


class DataPart(NamedTuple):
    """Some residuals, a mask of shape (m,), and the factor of their covariance without poses."""

    rows: BoolArray
    factor: FloatArray


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its optimum.

    Parameters
    ----------
    unknowns : Unknowns
    z : ndarray, shape (p,)
        Logarithms of the constants, then the parameters of the effects.
    predictions : tuple of ComparedScan
        Comparison with each scan.
    jacobian : ndarray, shape (m, p)
        Derivatives of the residuals in all scans.
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
        """Return all parameters by name, with constants instead of their logarithms."""
        k = len(self.unknowns.free)
        values = self.unknowns.constants(self.z)
        rest = zip(self.unknowns.names[k:], self.z[k:], strict=True)
        return values | {n: float(v) for n, v in rest}

    @property
    def at_bound(self) -> IntArray:
        """Bounds at which parameters were stopped; see `Unknowns.at_bound`."""
        return self.unknowns.at_bound(self.z)

    def residual(self, inverse: InverseProblem) -> FloatArray:
        """Return the residuals of all scans, concatenated, shape (s k,), in mm."""
        return residuals(inverse, self.predictions)

    def linearised(self, inverse: InverseProblem) -> Linearised:
        """Return residuals, derivatives and noise at the optimum, with the poses as noise."""
        u, poses = self.unknowns, self.pose_columns(inverse)
        factor = inverse.covariance_factor
        return Linearised(
            self.residual(inverse),
            self.jacobian,
            u.sd,
            self.z - u.mean,
            factored(inverse.covariance + poses @ poses.T) if poses.size else factor,
        )

    def linearised_with_poses(self, inverse: InverseProblem) -> Linearised:
        """Return the linearisation with poses and contour bias as additional free parameters.

        The gap is computed after fitting them, because the pose of a scan is not an error of the
        model.
        """
        u, q = self.unknowns, inverse.nuisance_count
        nuisances = np.hstack([self.pose_columns(inverse), inverse.drawing])
        return Linearised(
            self.residual(inverse),
            np.hstack([self.jacobian, nuisances]),
            np.append(u.sd, np.ones(q)),
            np.append(self.z - u.mean, np.zeros(q)),
            inverse.scatter_factor,
        )

    def log_evidence(
        self,
        inverse: InverseProblem,
        columns: FloatArray | None = None,
        part: DataPart | None = None,
    ) -> float:
        """Return the Laplace log evidence, in nats, on a common scale for all fits to the data.

        Parameters
        ----------
        inverse : InverseProblem
        columns : ndarray, shape (m, q), optional
            Further columns of unit prior deviation to free, such as a smooth field, in mm.
        part : DataPart, optional
            The residuals to use; all by default. The fit is updated to them by a linear step.
        """
        linear = self.linearised_with_poses(inverse)
        if columns is not None:
            linear = linear.freed(columns, np.ones(columns.shape[1]))
        if part is not None:
            linear = linear.of(part.rows, part.factor)
        q = len(linear.nominal_sd) - len(self.z)
        one_sided = np.append(self.unknowns.one_sided, np.zeros(q, np.bool_))
        return log_evidence(linear, one_sided, np.append(self.at_bound, np.zeros(q, np.int32)))

    def pose_columns(self, inverse: InverseProblem) -> FloatArray:
        """Return the pose columns; see `workers.diagnosis.problem.scan_prediction`."""
        return poses_of(inverse, self.predictions)


@dataclass(frozen=True, eq=False)
class SolvedFit(Fit):
    """A fit with the equilibria of its scans, as starting points for other fits."""

    predictions: tuple[PredictedScan, ...]

    def starts(self) -> list[Equilibrium]:
        """Return the equilibria from which another fit may start."""
        return [one.at for one in self.predictions]

    def poses(self) -> list[FloatArray | None]:
        """Return the poses of the scans."""
        return [one.pose for one in self.predictions]


def fit(
    inverse: InverseProblem,
    unknowns: Unknowns,
    start: FloatArray,
    starts: Sequence[Equilibrium | None],
    poses: Sequence[FloatArray | None] | None = None,
    each: Each = map,
    max_iterations: int = SETTINGS.fit.max_iterations,
) -> SolvedFit | None:
    """Find the most probable parameters.

    Parameters
    ----------
    start : ndarray, shape (p,)
        Starting values.
    starts : sequence of Equilibrium
        A nearby equilibrium of each scan; None to solve from rest.
    poses : sequence of ndarray, shape (6,), optional
        Initial poses of the scans, see `PredictedScan`; by default, the poses in their headers.
    each : callable
        Applies a function to every scan, like `map`, possibly in parallel.
    max_iterations : int
        Maximum number of iterations.

    Returns
    -------
    SolvedFit or None
        None if the simulation at the start does not converge.
    """
    z = np.clip(start, unknowns.lower, unknowns.upper)
    nowhere: Sequence[FloatArray | None] = poses or [None] * len(starts)
    predictions = _predict_scans(inverse, unknowns, z, starts, nowhere, each)
    if predictions is None:
        return None
    cost = _cost(inverse, unknowns, z, predictions)
    jacobians: list[ScanJacobian] | None = None
    placed = any(effect.place is not None for effect in unknowns.effects)
    tolerance = SETTINGS.fit.place_tolerance if placed else SETTINGS.fit.tolerance
    length, secant, stalls = 1.0, SecantCurvature.unknown(len(z)), 0
    for iteration in range(1, max_iterations + 1):
        if (listener := _listener.get()) is not None:
            listener(iteration)
        jacobians = _jacobians(inverse, unknowns, z, predictions, jacobians, each)
        fresh = all(jacobian.fresh for jacobian in jacobians)
        J = np.vstack([jacobian.columns for jacobian in jacobians])
        model = _local_model(inverse, unknowns, z, predictions, J)
        secant = secant.renewed(model) if fresh else secant.forgotten()
        step, expected = _step(unknowns, z, model.gradient, secant.curvature(model))
        if expected < tolerance:
            return SolvedFit(unknowns, z, predictions, J, cost, True, iteration)
        descent = _Descent(z, predictions, cost, length)
        next_descent = _descend(inverse, unknowns, descent, step, jacobians, each)
        if next_descent is None and not fresh:
            jacobians = None  # reused derivatives may point uphill
            continue
        at_rest = expected < SETTINGS.fit.at_rest
        fall = 0.0 if next_descent is None else cost - next_descent.cost
        settled = fall < tolerance
        if next_descent is not None:
            was_used = secant.is_used
            secant = secant.stepped(model, (next_descent.z - z) / unknowns.sd, fall)
            z, predictions, cost = next_descent.z, next_descent.predictions, next_descent.cost
            same = secant.is_used == was_used
            length = _next_length(next_descent.length, fall, expected) if same else 1.0
        stalls = stalls + 1 if settled else 0
        stuck = not secant.is_known or (next_descent is None and secant.is_used)
        if settled and (at_rest or stuck or stalls > SETTINGS.fit.stalls):
            break
        if settled and not secant.is_used:
            secant, length = secant.used(), 1.0
    jacobians = _jacobians(inverse, unknowns, z, predictions, jacobians, each)
    J = np.vstack([jacobian.columns for jacobian in jacobians])
    return SolvedFit(unknowns, z, predictions, J, cost, settled and at_rest, iteration)


def _next_length(length: float, fall: float, expected: float) -> float:
    """Return the initial length of the next step, after a step that reduced the cost."""
    if fall > SETTINGS.fit.underrated * expected:
        return SETTINGS.fit.further
    return min(1.0, length / SETTINGS.fit.shortening)


def _predict_scans(
    inverse: InverseProblem,
    unknowns: Unknowns,
    z: FloatArray,
    starts: Sequence[Equilibrium | None],
    poses: Sequence[FloatArray | None],
    each: Each,
) -> tuple[PredictedScan, ...] | None:
    def predicted(
        scan: Scan, start: Equilibrium | None, pose: FloatArray | None
    ) -> PredictedScan | None:
        return predict_scan(inverse, scan, unknowns, z, start, pose)

    predictions = []
    for prediction in each(predicted, inverse.scans, starts, poses):
        if prediction is None:
            return None
        predictions.append(prediction)
    return registered(inverse, unknowns, z, predictions)


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
    noise = PosedNoise(inverse, predictions)
    white = noise.whiten(residuals(inverse, predictions))
    return float(white @ noise.cleared(white) + (((z - u.mean) / u.sd) ** 2).sum())


def _local_model(
    inverse: InverseProblem,
    u: Unknowns,
    z: FloatArray,
    predictions: Sequence[PredictedScan],
    J: FloatArray,
) -> LocalModel:
    noise = PosedNoise(inverse, predictions)
    A = noise.whiten(J) * u.sd
    rho = noise.cleared(noise.whiten(residuals(inverse, predictions)))
    curvature = A.T @ noise.cleared(A) + np.eye(len(z))
    return LocalModel(A, rho, A.T @ rho + (z - u.mean) / u.sd, curvature)


def _step(
    u: Unknowns, z: FloatArray, gradient: FloatArray, curvature: FloatArray
) -> tuple[FloatArray, float]:
    """Return the step to the expected minimum of the cost, and the expected decrease in cost.

    Parameters at a bound stay there if they would move outwards.
    """
    held = np.zeros(len(z), bool)
    while True:
        go = np.flatnonzero(~held)
        step = np.zeros(len(z))
        step[go] = -np.linalg.solve(curvature[np.ix_(go, go)], gradient[go])
        blocked = ((z <= u.lower) & (step < 0)) | ((z >= u.upper) & (step > 0))
        if not (blocked & ~held).any():
            break
        held |= blocked
    longest = float(np.abs(step).max(initial=0.0))
    length = min(1.0, SETTINGS.fit.longest_step / longest if longest else 1.0)
    return np.asarray(step * u.sd * length), float(-gradient @ step)


def _starts(
    inverse: InverseProblem,
    predictions: Sequence[PredictedScan],
    jacobians: Sequence[ScanJacobian],
    change: FloatArray,
) -> list[Equilibrium | None]:
    """Return starting equilibria of the scans after a change in the parameters, (p,)."""
    return [
        inverse.forward.expecting(one.at, np.tensordot(change, jacobian.moved, 1))
        for one, jacobian in zip(predictions, jacobians, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Descent:
    """Parameters with their cost, and the fraction of the Gauss-Newton step taken."""

    z: FloatArray
    predictions: tuple[PredictedScan, ...]
    cost: float
    length: float


def _descend(
    inverse: InverseProblem,
    u: Unknowns,
    before: _Descent,
    step: FloatArray,
    jacobians: Sequence[ScanJacobian],
    each: Each,
) -> _Descent | None:
    """Shorten a step, starting from the previous length, until the cost falls."""
    poses, length = [prediction.pose for prediction in before.predictions], before.length
    for _ in range(SETTINGS.fit.max_halvings):
        z = np.clip(before.z + length * step, u.lower, u.upper)
        starts = _starts(inverse, before.predictions, jacobians, z - before.z)
        predictions = _predict_scans(inverse, u, z, starts, poses, each)
        if predictions is not None:
            cost = _cost(inverse, u, z, predictions)
            if cost < before.cost:
                return _Descent(z, predictions, cost, length)
        length *= SETTINGS.fit.shortening
    return None
