"""Predictions of the scans under a hypothesis: residuals, their derivatives, and the scans' poses.

Poses are unknown rigid motions of the scans, estimated at any values of the constants. A pose is
relative to the scan at rest, whose own error is common to all scans.

With residuals r of a model compared with scans at poses p, their derivatives -N with respect to the
poses, and other noise of covariance S, the poses minimise

.. math:: |S^{-1/2} (r + N p - N q)|^2 + |q|^2

over q, in prior standard deviations. N must be evaluated at the present pose: the normals of a
drawn interface change within a millimetre, and since all points together determine a pose far
better than its prior does, derivatives from elsewhere would give a different pose. Integrated over
q, r + N p has the covariance S + N N'.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from palpate.storage.values import FloatArray, IntArray, Tissue
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.noise.noise_components import correlated, pose_columns
from palpate.workers.diagnosis.problem.inverse_problem import (
    FollowedPoints,
    InverseProblem,
    Scan,
    Unknowns,
)
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.effects.observation_effects import rigid_columns, rigidly_moved
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Frame, Problem
from palpate.workers.mechanics.fem.equilibrium_sensitivity import RELATIVE_ERROR


@dataclass(frozen=True, eq=False)
class ComparedScan:
    """One scan compared with the model under one set of parameters.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Predicted positions of the points on the interfaces.
    residual : ndarray, shape (k,)
        Residual in mm, positive outside the observed tissue; includes the linear contribution of
        the scan's pose.
    normals : ndarray, shape (k, 3)
        Normals of the observed interfaces.
    """

    points: FloatArray
    residual: FloatArray
    normals: FloatArray


@dataclass(frozen=True, eq=False)
class PredictedScan(ComparedScan):
    """A compared scan with the equilibrium of the model, from which others can be solved.

    `followed` holds the points as followed. `pose` is the assumed pose of the scan: a motion of the
    model relative to the scan, with three shifts in mm and three rotations in degrees.
    """

    at: Equilibrium
    followed: FollowedPoints
    pose: FloatArray | None = None

    def along_normals(self, nodal: FloatArray) -> FloatArray:
        """Return the motion of the points along the normals, (k,), given nodal motion (n, 3)."""
        moved = self.followed.at_points @ nodal
        return np.asarray((moved * self.normals).sum(axis=1))


def tissues_of(inverse: InverseProblem) -> IntArray:
    """Return the tissue enclosed by the interface of each point: fat for the outline."""
    outline = inverse.points.interface == 0
    return np.where(outline, Tissue.FAT, Tissue.GLANDULAR).astype(np.int32)


def problem_of(
    scan: Scan, unknowns: Unknowns, z: FloatArray, frame: Frame, leave_out: Effect | None = None
) -> Problem:
    """Return the problem of a scan with the effects of a hypothesis, optionally except one."""
    problem = scan.problem(unknowns.constants(z))
    if any(effect.follows_path for effect in unknowns.effects):
        steps = min(problem.friction_steps, SETTINGS.fit.friction_steps)
        problem = replace(problem, friction_steps=steps)
    for effect in unknowns.effects:
        if effect is not leave_out:
            problem = effect.apply(problem, unknowns.of_effect(effect, z), frame)
    return problem


def predict_scan(
    inverse: InverseProblem,
    scan: Scan,
    unknowns: Unknowns,
    z: FloatArray,
    start: Equilibrium | None,
    pose: FloatArray | None = None,
) -> PredictedScan | None:
    """Simulate one scan; None if the simulation does not converge."""
    equilibrium = inverse.forward.equilibrium(
        inverse.model, problem_of(scan, unknowns, z, inverse.frame), start
    )
    return (
        compare_with_scan(inverse, scan, unknowns, z, equilibrium, pose)
        if equilibrium.solution.outcome.converged
        else None
    )


def compare_with_scan(
    inverse: InverseProblem,
    scan: Scan,
    unknowns: Unknowns,
    z: FloatArray,
    at: Equilibrium,
    pose: FloatArray | None = None,
) -> PredictedScan:
    """Compare an equilibrium with the scan at its nominal or assumed pose.

    Far from an interface, the distances to it are smoother than near it and no longer linear, so
    the motion of the scan is subtracted from the points, not from the distances.
    """
    followed = inverse.followed(scan)
    points = followed.moved(at.solution.displacement_mm)
    compared = compared_points(inverse, unknowns, z, points, pose)
    r, normals = scan.compare(compared, inverse.points)
    if pose is not None:
        r = r + rigid_columns(points, normals, inverse.frame.centre_mm) @ pose
    tissues = tissues_of(inverse)
    for effect in unknowns.effects:
        if not (effect.acts_on_body or effect.moves_scan):
            values = unknowns.of_effect(effect, z)
            places = _seen_by(effect, inverse, followed, at)
            shift = effect.shift(places, normals, tissues, values, inverse.frame)
            r = r + _where_seen(inverse, effect, shift)
    return PredictedScan(points, r, normals, at, followed, pose)


def compared_points(
    inverse: InverseProblem,
    unknowns: Unknowns,
    z: FloatArray,
    points: FloatArray,
    pose: FloatArray | None,
) -> FloatArray:
    """Return the positions of moved points in the coordinates of a scan, shape (k, 3)."""
    centre_mm = inverse.frame.centre_mm
    for effect in unknowns.effects:
        if effect.moves_scan:
            motion = np.array(list(unknowns.of_effect(effect, z).values()))
            points = rigidly_moved(points, motion, centre_mm)
    return points if pose is None else rigidly_moved(points, -pose, centre_mm)


@dataclass(frozen=True, eq=False)
class ScanJacobian:
    """Derivatives of one scan with respect to all parameters, shape (k, p), and their values `z`.

    `moved` holds the tangents of the nodal displacements, (p, n, 3). `fresh` is False if a column
    was reused from nearby parameter values.
    """

    z: FloatArray
    columns: FloatArray
    moved: FloatArray
    fresh: bool = True


def derivatives(
    inverse: InverseProblem,
    scan: Scan,
    unknowns: Unknowns,
    z: FloatArray,
    prediction: PredictedScan,
    before: ScanJacobian | None = None,
) -> ScanJacobian:
    """Return the derivatives of the residual with respect to every parameter.

    Tangents describe only the last load step. For a path-dependent effect, such as friction, the
    derivative comes from another simulation, unless `before` was computed at about the same value;
    for other parameters the tangents are accurate enough.
    """
    moved, fresh = _moved_nodes(inverse, scan, unknowns, z, prediction), True
    columns = _columns_of_all(inverse, unknowns, z, prediction, moved)
    taken_at = z.copy()
    for name in (n for effect in unknowns.effects if effect.follows_path for n in effect.names):
        index = unknowns.names.index(name)
        near = SETTINGS.fit.friction_near * unknowns.sd[index]
        if before is not None and abs(z[index] - before.z[index]) < near:
            # Keep the value at which that column was computed, so that the column does not drift.
            columns[:, index] = before.columns[:, index]
            taken_at[index] = before.z[index]
            fresh = False
        else:
            columns[:, index] = _by_solving(inverse, scan, unknowns, z, prediction, index)
    return ScanJacobian(taken_at, columns, moved, fresh)


def _moved_nodes(
    inverse: InverseProblem,
    scan: Scan,
    unknowns: Unknowns,
    z: FloatArray,
    prediction: PredictedScan,
) -> FloatArray:
    """Return the tangents of all parameters, (p, n, 3); zero for path-dependent effects."""
    changes = [_log_change(inverse, scan, unknowns, z, i) for i in range(len(unknowns.free))]
    moving = list(range(len(unknowns.free)))
    for effect in unknowns.effects:
        if effect.acts_on_body and not effect.follows_path:
            base = problem_of(scan, unknowns, z, inverse.frame, leave_out=effect)
            changes.extend(effect.changes(base, inverse.frame, unknowns.of_effect(effect, z)))
            moving.extend(unknowns.names.index(name) for name in effect.names)
    tangents = inverse.forward.tangents(prediction.at, changes, SETTINGS.fit.tangent_error)
    moved = np.zeros((len(z), *tangents.shape[1:]))
    moved[moving] = tangents
    return moved


def _columns_of_all(
    inverse: InverseProblem,
    unknowns: Unknowns,
    z: FloatArray,
    prediction: PredictedScan,
    moved: FloatArray,
) -> FloatArray:
    """Return derivatives of the residual for all parameters, given the motion of the nodes."""
    observed = [(e, unknowns.of_effect(e, z)) for e in unknowns.effects if not e.acts_on_body]
    columns = _along_motions(inverse, prediction, moved, observed)
    for effect, _ in observed:
        first = unknowns.names.index(effect.names[0])
        which = slice(first, first + len(effect.names))
        columns[:, which] = observed_columns(inverse, effect, prediction)
    return columns


def _by_solving(
    inverse: InverseProblem,
    scan: Scan,
    unknowns: Unknowns,
    z: FloatArray,
    prediction: PredictedScan,
    at: int,
) -> FloatArray:
    """Return the column of parameter number `at`; zero if the simulation fails."""
    h = SETTINGS.fit.friction_step * unknowns.sd[at]
    ahead = z.copy()
    ahead[at] += h
    simulation = predict_scan(inverse, scan, unknowns, ahead, prediction.at, prediction.pose)
    if simulation is None:
        return np.zeros_like(prediction.residual)
    return (simulation.residual - prediction.residual) / h


def columns_of(
    inverse: InverseProblem,
    prediction: PredictedScan,
    changes: Sequence[Change],
    tolerance: float = RELATIVE_ERROR,
) -> FloatArray:
    """Return derivatives of the residual for changes in the problem, shape (k, c).

    `tolerance` is passed to `tangents`.
    """
    moved = inverse.forward.tangents(prediction.at, changes, tolerance)
    return _along_motions(inverse, prediction, moved)


def _along_motions(
    inverse: InverseProblem,
    prediction: PredictedScan,
    moved: FloatArray,
    observed: Sequence[tuple[Effect, Mapping[str, float]]] = (),
) -> FloatArray:
    """Return derivatives of the residual along motions of the nodes, (c, n, 3): (k, c).

    `observed` holds the acting effects on the observation with their values; their shifts change
    with the position of a point.
    """
    out = np.empty((len(prediction.residual), len(moved)))
    for c, nodal in enumerate(moved):
        out[:, c] = prediction.along_normals(nodal)
        for effect, values in observed:
            out[:, c] += _shift_along(inverse, prediction, effect, values, nodal)
    return out


def _shift_along(
    inverse: InverseProblem,
    prediction: PredictedScan,
    effect: Effect,
    values: Mapping[str, float],
    u: FloatArray,
) -> FloatArray:
    """Return the derivative of `Effect.shift`, affine in its input, along nodal motion `u`."""
    here = _seen_by(effect, inverse, prediction.followed, prediction.at)
    step = _moves(effect, inverse, prediction.followed, u)
    rest = prediction.normals, tissues_of(inverse), values, inverse.frame
    change = effect.shift(here + step, *rest) - effect.shift(here, *rest)
    return _where_seen(inverse, effect, change)


def observed_columns(
    inverse: InverseProblem, effect: Effect, prediction: PredictedScan
) -> FloatArray:
    """Return derivatives for the parameters of an effect on the observation, shape (k, q)."""
    if effect.observation is None:
        raise ValueError(f"{effect.name} acts on the body")
    places = _seen_by(effect, inverse, prediction.followed, prediction.at)
    rest = prediction.normals, tissues_of(inverse), inverse.frame
    return _where_seen(inverse, effect, effect.observation(places, *rest))


def _where_seen(inverse: InverseProblem, effect: Effect, shift: FloatArray) -> FloatArray:
    """Set an observation effect's shift, (k, ...), to zero where the effect does not act."""
    acts = inverse.is_force if effect.sees == "cells" else ~inverse.is_force
    return np.where(acts.reshape(-1, *[1] * (shift.ndim - 1)), shift, 0.0)


def _seen_by(
    effect: Effect, inverse: InverseProblem, followed: FollowedPoints, at: Equilibrium
) -> FloatArray:
    """Return the input points of an effect on the observation; see `Effect.sees`."""
    moved = _moves(effect, inverse, followed, at.solution.displacement_mm)
    return followed.points + moved if effect.sees == "points" else moved


def _moves(
    effect: Effect, inverse: InverseProblem, followed: FollowedPoints, u: FloatArray
) -> FloatArray:
    """Return the change in an effect's input for motion `u` of the nodes, shape (k, 3)."""
    if effect.sees != "arms":
        return np.asarray(followed.at_points @ u)
    if inverse.arms is None:
        raise ValueError(f"{effect.name} needs markers")
    return np.asarray(inverse.arms @ u)


def _log_change(
    inverse: InverseProblem, scan: Scan, unknowns: Unknowns, z: FloatArray, i: int
) -> Change:
    ahead, behind = z.copy(), z.copy()
    ahead[i] += SETTINGS.fit.log_step
    behind[i] -= SETTINGS.fit.log_step
    plus, minus = (problem_of(scan, unknowns, at, inverse.frame) for at in (ahead, behind))
    return Change(plus, minus, 2 * SETTINGS.fit.log_step)


def residuals(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> FloatArray:
    """Return the residuals of all scans, without the mesh bias, shape (m,)."""
    return np.concatenate([v.residual for v in predictions]) - inverse.bias


def poses_of(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> FloatArray:
    """Return derivatives of the residuals with respect to poses, per prior sd, (m, 6 s).

    There are no columns if the poses are known.
    """
    if not inverse.has_poses:
        return np.zeros((len(inverse.bias), 0))
    points, normals = [v.points for v in predictions], [v.normals for v in predictions]
    return pose_columns(points, normals, inverse.frame.centre_mm, *inverse.pose_sd)


class PosedNoise:
    """The noise of residuals with uncertain poses.

    Parameters
    ----------
    inverse : InverseProblem
    predictions : sequence of ComparedScan
        Predictions that provide the pose columns.
    """

    def __init__(self, inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> None:
        self._factor = inverse.covariance_factor
        self._poses = self.whiten(poses_of(inverse, predictions))
        curvature = np.eye(self._poses.shape[1]) + self._poses.T @ self._poses
        self._curvature = cho_factor(curvature, lower=True)

    def whiten(self, values: FloatArray) -> FloatArray:
        """Return values, (m,) or (m, k), in the space where the noise without poses is white."""
        return np.asarray(
            solve_triangular(self._factor, values, lower=True, check_finite=False), np.float64
        )

    def poses(self, white: FloatArray) -> FloatArray:
        """Return the most probable poses for whitened residuals, in prior standard deviations."""
        return np.asarray(cho_solve(self._curvature, self._poses.T @ white))

    def cleared(self, white: FloatArray) -> FloatArray:
        """Return whitened values times the precision that remains after fitting poses."""
        return white - self._poses @ self.poses(white)


def registered(
    inverse: InverseProblem, unknowns: Unknowns, z: FloatArray, found: Sequence[PredictedScan]
) -> tuple[PredictedScan, ...]:
    """Estimate the poses from the residuals, and compare with the scans in these poses.

    The cost is meaningful only once the poses have converged; off the interface, it is too low.
    Distances may have a kink at which the best pose alternates between both sides, so steps that
    do not become shorter are halved.
    """
    found = tuple(found)
    if not inverse.has_poses:
        return found
    sd = np.repeat(inverse.pose_sd, 3)
    poses = np.array(
        [np.zeros(6) if prediction.pose is None else prediction.pose for prediction in found]
    )
    poses /= np.where(sd > 0, sd, 1.0)
    length, before = 1.0, np.inf
    for _ in range(SETTINGS.pose.registrations):
        noise = PosedNoise(inverse, found)
        best = noise.poses(noise.whiten(residuals(inverse, found)))
        step = correlated(best.reshape(poses.shape)) - poses
        longest = float(np.abs(step).max())
        if longest > SETTINGS.pose.shorter * before:
            length /= 2
        if length * longest < SETTINGS.pose.settled:
            break
        poses, before = poses + length * step, longest
        found = tuple(
            compare_with_scan(inverse, scan, unknowns, z, prediction.at, sd * pose)
            for scan, prediction, pose in zip(inverse.scans, found, poses, strict=True)
        )
    return found
