"""Observed and predicted displacements of each point of a specimen, as rows of a summary.

A fitted model also predicts states that were not measured, with their uncertainty.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Triple
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.gauss_newton import Fit
from palpate.workers.diagnosis.linearisation import LinearFit
from palpate.workers.diagnosis.outcome.diagnosis_summary import (
    MarkerResidual,
    MarkerState,
    PredictedPoint,
    PredictedState,
    Reaction,
    ReactionResidual,
    RegionGap,
)
from palpate.workers.diagnosis.outcome.gap_and_shrinkage import region_gap
from palpate.workers.diagnosis.problem.inverse_problem import FORCE, InverseProblem, Scan
from palpate.workers.diagnosis.problem.scan_prediction import PredictedScan, predict_scan
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium
from palpate.workers.organs.specimen.load_cells import LoadCell
from palpate.workers.organs.specimen.marker_and_field_data import Observed
from palpate.workers.organs.specimen.specimen_keys import PredictSpec, SpecimenSpec

# Step of the finite differences, in standard deviations of the posterior.
PREDICTION_STEP = 0.5
# Fitted states whose sizes differ by a smaller factor show no trend.
LIKE_SIZED = 2 / 3
# Noise alone leaves a larger trend than one that is extrapolated with this probability.
BY_CHANCE = 0.05


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted displacements of a state, as m compared components with standard deviations.

    Parameters
    ----------
    name : str
        Name of the state.
    moved_mm, sd_mm : ndarray, shape (m,)
        In the frame of the body. The standard deviation of a recording from the prediction: the
        uncertainty of the fitted parameters, the unexplained residual, see `unexplained_at`, and
        the noise of one recording, see `RecordingNoise`.
    force_mm, force_sd_mm : ndarray, shape (c,)
        Predicted readings of the load cells, as displacements, with standard deviations.
    """

    name: str
    moved_mm: FloatArray
    sd_mm: FloatArray
    force_mm: FloatArray
    force_sd_mm: FloatArray


@dataclass(frozen=True)
class RecordingNoise:
    """Noise of one component of one point in a new recording.

    Parameters
    ----------
    stated_mm : float
        Standard deviation as stated.
    recording_mm : float
        The same, with the scatter between repeats of the fitted states.
    """

    stated_mm: float
    recording_mm: float

    def variance(self, inverse: InverseProblem, fit: Fit, moved: FloatArray) -> FloatArray:
        """Return the variance of the noise in a state, of load cells as in the fitted states, (m,).

        What repeats scatter beyond the stated noise grows in proportion to the displacement.
        """
        force = inverse.is_force
        fitted = float(np.sqrt((_sizes(inverse, fit) ** 2).mean()))
        further = max(1.0, _size(moved[~force]) / fitted) if fitted > 0 else 1.0
        beyond = max(0.0, self.recording_mm**2 - self.stated_mm**2)
        _, variance = _by_state(inverse, fit)
        return np.where(force, variance.mean(axis=0), self.stated_mm**2 + further**2 * beyond)


def predict(
    inverse: InverseProblem,
    fit: Fit,
    states: Sequence[Scan],
    ends: Sequence[FloatArray],
    noise: RecordingNoise,
) -> list[Prediction]:
    """Simulate other states of a body with the fitted parameters.

    Parameters
    ----------
    inverse : InverseProblem
        Inverse problem whose points are compared along x, y and z, one after another.
    fit : Fit
        Fit of the constants and of any effects.
    states : sequence of Scan
        States whose residuals are relative to the body at rest.
    ends : sequence of ndarray, shape (m,)
        Variances that measured boundaries add to each state.
    noise : RecordingNoise

    Raises
    ------
    InputError
        If a state cannot be simulated.
    """
    spread, force = posterior_factor(inverse, fit), inverse.is_force
    predictions = []
    for scan, end in zip(states, ends, strict=True):
        view = _view(inverse, scan, fit, fit.z, None)
        parts = []
        for direction in PREDICTION_STEP * spread.T:
            z = np.clip(fit.z + direction, fit.unknowns.lower, fit.unknowns.upper)
            parts.append(
                (_view(inverse, scan, fit, z, view.at).residual - view.residual) / PREDICTION_STEP
            )
        left = unexplained_at(inverse, fit, view.residual)
        new = noise.variance(inverse, fit, view.residual)
        sd = np.sqrt((np.array(parts) ** 2).sum(axis=0) + left**2 + end + new)
        moved, moved_sd = (components[~force] for components in (view.residual, sd))
        predictions.append(Prediction(scan.name, moved, moved_sd, view.residual[force], sd[force]))
    return predictions


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

    The error of a wrong model is assumed to grow at least in proportion to the displacement, see
    `_unexplained_trend`. Constants that were fitted to the readings of load cells leave them no
    residual, so a force is known no better than the displacements are explained: an error of a
    fifth of the displacements is also one of a fifth of the force.
    """
    force, size = inverse.is_force, _size(moved[~inverse.is_force])
    sd = _unexplained_trend(inverse, fit, size)
    share = _size(sd[~force]) / size if size > 0 else 0.0
    return np.where(force, np.hypot(sd, share * moved), sd)


def _unexplained_trend(inverse: InverseProblem, fit: Fit, size: float) -> FloatArray:
    """Return the unexplained residual in a state of some root mean square displacement, (m,).

    If the fitted states differ in size s, residuals that change with it beyond chance are
    extrapolated, as ``a s + b s^2``; of forces as ``a s + b s^3``, because tissue stiffens.
    """
    sizes = _sizes(inverse, fit)
    largest = float(sizes.max())
    if largest == 0:
        return unexplained_sd(inverse, fit)
    sd = max(1.0, size / largest) * unexplained_sd(inverse, fit)
    if size <= largest or sizes.min() > LIKE_SIZED * largest:
        return sd
    residual, variance = _by_state(inverse, fit)
    for part in np.unique(inverse.points.interface):
        here, power = inverse.points.interface == part, 3 if part == FORCE else 2
        weights = np.array([size, size**power]) @ np.linalg.pinv(
            np.column_stack([sizes, sizes**power])
        )
        squares, noise = (weights @ residual[:, here]) ** 2, weights**2 @ variance[:, here]
        if (squares / noise).sum() > chdtri(len(noise), BY_CHANCE):
            trend = np.sqrt(max(0.0, float((squares - noise).mean())))
            sd[here] = np.maximum(sd[here], trend)
    return sd


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


def _sizes(inverse: InverseProblem, fit: Fit) -> FloatArray:
    """Return the root mean square displacement in each fitted state, shape (s,)."""
    place = ~inverse.is_force
    return np.array(
        [_size(_moved(inverse, prediction.points)[place]) for prediction in fit.predictions]
    )


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
    prediction = predict_scan(alone, scan, fit.unknowns, z, start)
    if prediction is None and start is not None:
        # Started from a neighbouring solution at full load, a soft body may overshoot.
        prediction = predict_scan(alone, scan, fit.unknowns, z, None)
    if prediction is None:
        raise InputError(
            f"The state {scan.name} cannot be simulated with the fitted constants. Check its loads."
        )
    return prediction


COMPONENTS = ("displacement along x", "displacement along y", "displacement along z")


def region_rows(diagnosis: Diagnosis) -> Iterator[RegionGap]:
    """Yield the gap of the nominal model along each axis, for all points and by thirds.

    The thirds divide the points along the axis of their largest extent.
    """
    inverse, fit = diagnosis.analysis.inverse, LinearFit(diagnosis.analysis.linear)
    points, component = inverse.points.points, inverse.points.interface
    own = ~inverse.is_force
    longest = int(np.ptp(points[own], axis=0).argmax())
    low, high = points[own, longest].min(), points[own, longest].max()
    along = 3 * (points[:, longest] - low) / max(high - low, 1e-12)
    name = "xyz"[longest]
    parts = {
        "all": np.ones(len(along), np.bool_),
        f"lowest third of {name}": along < 1,
        f"middle third of {name}": (along >= 1) & (along <= 2),
        f"highest third of {name}": along > 2,
    }
    for number, scan in enumerate(inverse.scans):
        for axis, seen in enumerate(COMPONENTS):
            for region, inside in parts.items():
                chosen = np.tile(own & inside & (component == axis), len(inverse.scans))
                chosen &= inverse.rows == number
                if chosen.sum() >= SETTINGS.gap.fewest_residuals:
                    yield region_gap(fit, chosen, scan.name, seen, region)


def marker_states(
    observed: Observed, spec: SpecimenSpec, cells: Sequence[LoadCell], diagnosis: Diagnosis
) -> tuple[MarkerState, ...]:
    """Return the observed displacements of each state and the residuals of the models.

    Parameters
    ----------
    observed : Observed
    spec : SpecimenSpec
    cells : sequence of LoadCell
    diagnosis : Diagnosis
    """
    inverse = diagnosis.analysis.inverse
    whole, place = diagnosis.analysis.linear.residual, inverse.is_place
    before, forces = _at_points(observed, whole[place]), whole[~place]
    after, forces_after = None, None
    if diagnosis.best is not None:
        whole = diagnosis.best.fit.linearised(inverse).residual
        after, forces_after = _at_points(observed, whole[place]), whole[~place]
    reactions = _reactions(spec, cells, forces, forces_after)
    return tuple(
        MarkerState(
            state.name,
            None if np.isnan(observed.repeats_mm[s]) else observed.repeats_mm[s],
            tuple(
                MarkerResidual(
                    name,
                    _triple(observed.moved_mm[s, i]),
                    _triple(before[s, i]),
                    None if after is None else _triple(after[s, i]),
                )
                for i, name in enumerate(observed.names)
            ),
            reactions[s],
        )
        for s, state in enumerate(spec.states)
    )


def _at_points(observed: Observed, compared: FloatArray) -> FloatArray:
    """Return the compared components of all states as points, shape (s, k, 3)."""
    states = compared.reshape(len(observed.moved_mm), -1)
    return np.array([_spread(observed, state) for state in states])


def _spread(observed: Observed, compared: FloatArray) -> FloatArray:
    """Return the compared components of one state, nan elsewhere, shape (k, 3)."""
    found = np.full(observed.measured.shape, np.nan)
    found[observed.measured] = compared
    return found


def predicted_states(
    observed: Observed,
    spec: SpecimenSpec,
    cells: Sequence[LoadCell],
    predictions: Sequence[Prediction],
) -> tuple[PredictedState, ...]:
    """Return the predicted displacements and forces of each state that was not measured."""
    return tuple(
        PredictedState(
            prediction.name,
            tuple(
                PredictedPoint(name, *(_triple(row) for row in rows))
                for name, *rows in zip(
                    observed.names,
                    _spread(observed, prediction.moved_mm),
                    _spread(observed, prediction.sd_mm),
                    *([observed.held_out_of(state, spec)] if state.files else []),
                    strict=True,
                )
            ),
            tuple(_predicted_reactions(spec, state, cells, prediction)),
        )
        for prediction, state in zip(predictions, spec.predict, strict=True)
    )


def _reactions(
    spec: SpecimenSpec,
    cells: Sequence[LoadCell],
    before_mm: FloatArray,
    after_mm: FloatArray | None,
) -> list[tuple[ReactionResidual, ...]]:
    """Return the readings and residuals of each state, from residuals in mm of all states."""
    shape = len(spec.states), len(cells)
    before = before_mm.reshape(shape)
    after = None if after_mm is None else after_mm.reshape(shape)
    return [
        tuple(
            ReactionResidual(
                reaction.region,
                reaction.axis,
                reaction.force_n,
                reaction.sd_n,
                float(before[s, c] / cell.mm_per_n),
                None if after is None else float(after[s, c] / cell.mm_per_n),
            )
            for c, (reaction, cell) in enumerate(zip(state.reactions, cells, strict=True))
        )
        for s, state in enumerate(spec.states)
    ]


def _predicted_reactions(
    spec: SpecimenSpec, state: PredictSpec, cells: Sequence[LoadCell], predicted: Prediction
) -> Iterator[Reaction]:
    """Yield the predicted forces on the regions that move in a state."""
    moved = {(move.region, axis) for move in state.moves for axis in move.axes}
    read = zip(
        spec.states[0].reactions, cells, predicted.force_mm, predicted.force_sd_mm, strict=True
    )
    for reaction, cell, force_mm, sd_mm in read:
        if (reaction.region, reaction.axis) in moved:
            values = float(force_mm / cell.mm_per_n), float(sd_mm / cell.mm_per_n)
            yield Reaction(reaction.region, reaction.axis, *values)


def _triple(values: FloatArray) -> Triple:
    x, y, z = values.tolist()
    return x, y, z
