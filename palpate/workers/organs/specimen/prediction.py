"""Predictions of a fitted model for states that were not measured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.fits.gauss_newton import Fit
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem, Scan
from palpate.workers.diagnosis.problem.scan_prediction import PredictedScan, predict_scan
from palpate.workers.mechanics.fem.equilibrium.solve import Equilibrium

# Step of the finite differences, in standard deviations of the posterior.
STEP = 0.5
# Fitted states whose sizes differ by a smaller factor show no trend.
LIKE_SIZED = 2 / 3


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted displacements of a state, as m compared components with standard deviations.

    Parameters
    ----------
    name : str
        Name of the state.
    moved_mm, sd_mm : ndarray, shape (m,)
        In the frame of the body. The standard deviation combines the uncertainty of the fitted
        parameters and the unexplained residual, see `unexplained_sd`; the noise of a new recording
        is not included.
    force_mm, force_sd_mm : ndarray, shape (c,)
        Predicted readings of the load cells, as displacements, with standard deviations.
    """

    name: str
    moved_mm: FloatArray
    sd_mm: FloatArray
    force_mm: FloatArray
    force_sd_mm: FloatArray


def predict(inverse: InverseProblem, fit: Fit, states: Sequence[Scan]) -> list[Prediction]:
    """Simulate other states of a body with the fitted parameters.

    Parameters
    ----------
    inverse : InverseProblem
        Inverse problem whose points are compared along x, y and z, one after another.
    fit : Fit
        Fit of the constants and of any effects.
    states : sequence of Scan
        States whose residuals are relative to the body at rest.

    Raises
    ------
    InputError
        If a state cannot be simulated.
    """
    spread, force = posterior_factor(inverse, fit), inverse.is_force
    found = []
    for scan in states:
        at = _view(inverse, scan, fit, fit.z, None)
        parts = []
        for direction in STEP * spread.T:
            z = np.clip(fit.z + direction, fit.unknowns.lower, fit.unknowns.upper)
            parts.append((_view(inverse, scan, fit, z, at.at).residual - at.residual) / STEP)
        left = unexplained_at(inverse, fit, at.residual)
        sd = np.sqrt((np.array(parts) ** 2).sum(axis=0) + left**2)
        moved, moved_sd = (one[~force] for one in (at.residual, sd))
        found.append(Prediction(scan.name, moved, moved_sd, at.residual[force], sd[force]))
    return found


def unexplained_sd(inverse: InverseProblem, fit: Fit) -> FloatArray:
    """Return the residual of the fit in excess of the noise, for each compared component, in mm.

    It is the root mean square over all states and all components along one axis, or over all
    readings of load cells, because its distribution in another state is unknown.

    Returns
    -------
    ndarray, shape (m,)
    """
    residual, variance = _by_state(inverse, fit)
    return _beyond_noise(inverse, residual**2 - variance)


def unexplained_at(inverse: InverseProblem, fit: Fit, moved: FloatArray) -> FloatArray:
    """Return the standard deviation of the unexplained residual in another state, (m,).

    The error of a wrong model is assumed to grow at least in proportion to the displacement. If
    the fitted states differ in size, residuals that change with it are extrapolated, as
    ``a s + b s^2`` for a state of size s.
    """
    place = ~inverse.is_force
    sizes = np.array([_size(_moved(inverse, one.points)[place]) for one in fit.predictions])
    size, largest = _size(moved[place]), float(sizes.max())
    if largest == 0:
        return unexplained_sd(inverse, fit)
    found = max(1.0, size / largest) * unexplained_sd(inverse, fit)
    if size <= largest or sizes.min() > LIKE_SIZED * largest:
        return found
    weights = np.array([size, size**2]) @ np.linalg.pinv(np.column_stack([sizes, sizes**2]))
    residual, variance = _by_state(inverse, fit)
    trend = (weights @ residual) ** 2 - weights**2 @ variance
    return np.maximum(found, _beyond_noise(inverse, trend[None]))


def _by_state(inverse: InverseProblem, fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Return the residuals and the variance of their noise, shape (s, m) each."""
    states = len(inverse.scans)
    return (
        fit.residual(inverse).reshape(states, -1),
        np.diag(inverse.covariance).reshape(states, -1),
    )


def _beyond_noise(inverse: InverseProblem, squares: FloatArray) -> FloatArray:
    """Return the root mean of squares, (s, m), over components along an axis, and over cells."""
    found = np.empty(squares.shape[1])
    for part in np.unique(inverse.points.interface):
        here = inverse.points.interface == part
        found[here] = np.sqrt(max(0.0, float(squares[:, here].mean())))
    return found


def _moved(inverse: InverseProblem, points: FloatArray) -> FloatArray:
    return np.asarray(((points - inverse.points.points) * inverse.points.normals).sum(axis=1))


def _size(moved_mm: FloatArray) -> float:
    return float(np.sqrt((moved_mm**2).mean()))


def posterior_factor(inverse: InverseProblem, fit: Fit) -> FloatArray:
    """Return L, (p, p), where L L' is the posterior covariance of the fitted parameters."""
    at = fit.linearised(inverse)
    A = at.scaled_nominal
    inner = np.linalg.inv(np.eye(A.shape[1]) + A.T @ A)
    return np.asarray(at.nominal_sd[:, None] * np.linalg.cholesky(inner))


def _view(
    inverse: InverseProblem, scan: Scan, fit: Fit, z: FloatArray, start: Equilibrium | None
) -> PredictedScan:
    alone = replace(inverse, scans=[scan])
    found = predict_scan(alone, scan, fit.unknowns, z, start)
    if found is None and start is not None:
        # Started from a neighbouring solution at full load, a soft body may overshoot.
        found = predict_scan(alone, scan, fit.unknowns, z, None)
    if found is None:
        raise InputError(
            f"The state {scan.name} cannot be simulated with the fitted constants. Check its loads."
        )
    return found
