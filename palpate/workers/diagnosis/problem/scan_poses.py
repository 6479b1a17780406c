r"""Poses of the scans: unknown rigid motions, estimated at any values of the constants.

A pose is relative to the scan at rest, whose own error is common to all scans.

With residuals r of a model compared with scans at poses p, their derivatives -N with respect to the
poses, and other noise of covariance S, the poses minimise

.. math:: |S^{-1/2} (r + N p - N q)|^2 + |q|^2

over q, in prior standard deviations. N must be evaluated at the present pose: the normals of a
drawn interface change within a millimetre, and since all points together determine a pose far
better than its prior does, derivatives from elsewhere would give a different pose. Integrated over
q, r + N p has the covariance S + N N'.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.noise.nuisances import correlated, pose_columns
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem, Unknowns
from palpate.workers.diagnosis.problem.scan_prediction import (
    ComparedScan,
    PredictedScan,
    compare_with_scan,
)
from palpate.workers.diagnosis.settings.values import SETTINGS


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
    poses = np.array([np.zeros(6) if one.pose is None else one.pose for one in found])
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
            compare_with_scan(inverse, scan, unknowns, z, one.at, sd * pose)
            for scan, one, pose in zip(inverse.scans, found, poses, strict=True)
        )
    return found
