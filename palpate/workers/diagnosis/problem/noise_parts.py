"""Components of a case's noise, at the first fit of its constants."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.comparison.observation.noise import correlation, covariance
from palpate.workers.diagnosis.noise.model import NoiseParts
from palpate.workers.diagnosis.noise.nuisances import drawing_columns, pose_columns, smooth_columns
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.scan_prediction import ComparedScan
from palpate.workers.diagnosis.problem.voxel_steps import voxel_steps
from palpate.workers.diagnosis.settings.values import SETTINGS


def noise_parts(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> NoiseParts:
    """Return the noise components of an inverse problem whose constants have been fitted once.

    Parameters
    ----------
    inverse : InverseProblem
        Problem with the bias of its mesh and the given covariance.
    predictions : sequence of ComparedScan
        Comparison with each scan.
    """
    return NoiseParts(
        stated=stated_covariances(inverse),
        lengths=noise_lengths(inverse),
        groups=np.tile(inverse.points.interface, len(inverse.scans)),
        fixed=np.hstack([_drawing(inverse), voxel_steps(inverse, predictions)]),
        numerical=_numerical(inverse, predictions),
    )


def planned_covariance(inverse: InverseProblem) -> FloatArray:
    """Return the noise covariance of planned scans, shape (m, m), in mm^2.

    It is the given covariance, with poses and contour bias, for the points at rest.
    """
    scans, points = len(inverse.scans), inverse.points
    carried = np.ones((scans, len(points)))
    drawn = covariance(points, inverse.noise, scans) + _smoother(inverse, 1.0, carried)
    fixed = _drawing(inverse)
    if inverse.is_segmented:
        centre_mm, at_rest = inverse.frame.centre_mm, ([points.points], [points.normals])
        moved, normals = (one * scans for one in at_rest)
        fixed = np.hstack([pose_columns(moved, normals, centre_mm, *inverse.pose_sd), fixed])
    return np.asarray(drawn + fixed @ fixed.T)


def _drawing(inverse: InverseProblem) -> FloatArray:
    """Return the columns of contour bias."""
    sd_mm = inverse.noise.sd_mm
    each = SETTINGS.pose.drawing * sd_mm if inverse.is_segmented else 0.0
    common = SETTINGS.noise.common * sd_mm
    return drawing_columns(inverse.points.interface, len(inverse.scans), common, each)


def noise_lengths(inverse: InverseProblem) -> tuple[float, ...]:
    """Return the correlation lengths divided by the given length; only 1 for measured noise."""
    return SETTINGS.noise.lengths if inverse.is_segmented else (1.0,)


def stated_covariances(inverse: InverseProblem) -> tuple[FloatArray, ...]:
    """Return the given noise covariance for each correlation length, shape (m, m)."""
    if not inverse.is_segmented:
        return (inverse.covariance + _smoother(inverse, 1.0, _carried(inverse)),)
    found = []
    for factor in noise_lengths(inverse):
        noise = replace(inverse.noise, correlation_mm=factor * inverse.noise.correlation_mm)
        carried = _carried(inverse)
        drawn = covariance(inverse.points, noise, len(inverse.scans), carried)
        found.append(drawn + _smoother(inverse, factor, carried))
    return tuple(found)


def _carried(inverse: InverseProblem) -> FloatArray:
    """Return the share of the error at rest that enters each scan's residuals, shape (s, k)."""
    return 1.0 - np.stack([inverse.followed(scan).pressed for scan in inverse.scans])


def _smoother(inverse: InverseProblem, factor: float, carried: FloatArray) -> FloatArray:
    """Return the covariance of the part of the noise that is smoother than given.

    `carried` is the share of the error at rest that enters each scan's residuals, shape (s, k).
    """
    settings, noise, scans = SETTINGS.noise, inverse.noise, len(inverse.scans)
    smooth = correlation(inverse.points, settings.smoother_lengths * factor * noise.correlation_mm)
    at_rest = noise.reference_sd_mm * carried.ravel()
    found = np.kron(np.eye(scans), noise.sd_mm**2 * smooth)
    found += np.tile(smooth, (scans, scans)) * np.outer(at_rest, at_rest)
    return np.asarray(settings.smoother**2 * found)


def _numerical(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> FloatArray:
    """Return the columns of the numerical error, which grows with element size and load."""
    settings, shape = SETTINGS.numerical, (len(inverse.scans), -1)
    difference = np.sqrt((inverse.bias.reshape(shape) ** 2).mean(axis=1))
    least_mm = max(settings.least_mm, settings.of_nugget * inverse.noise.nugget_mm)
    each = np.hypot(settings.of_difference * difference, least_mm)
    alike = settings.state_correlation
    if not inverse.is_segmented:
        each = settings.of_difference * difference
        alike = settings.state_correlation_markers
    return smooth_columns(
        np.tile(inverse.points.points, (len(inverse.scans), 1)),
        np.concatenate([one.normals for one in predictions]),
        inverse.rows,
        np.repeat(each, len(inverse.points)),
        settings.length_mm,
        alike.between(inverse.directions),
    )
