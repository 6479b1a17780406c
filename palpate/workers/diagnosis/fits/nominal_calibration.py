"""Calibration: the fit of the nominal model, with the noise of the scans and of the mesh."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, TetMesh
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.gauss_newton import Fit, SolvedFit, fit
from palpate.workers.diagnosis.noise.noise_components import pose_columns, smooth_columns
from palpate.workers.diagnosis.noise.noise_scale import noise_scales
from palpate.workers.diagnosis.noise.unmatched_points import matched
from palpate.workers.diagnosis.problem.inverse_problem import (
    InverseProblem,
    Scan,
    Unknowns,
    at_points_with_forces,
    unknowns,
)
from palpate.workers.diagnosis.problem.scan_noise import (
    anchored,
    pressed_shares,
    stated_noise,
    with_pressed_points,
)
from palpate.workers.diagnosis.problem.scan_prediction import (
    ComparedScan,
    PredictedScan,
    compare_with_scan,
    predict_scan,
    residuals,
)
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.fem.discretisation import Model


def calibrate(
    inverse: InverseProblem, finer: Model | None = None, each: Each = map
) -> tuple[InverseProblem, SolvedFit]:
    """Fit the nominal constants, then refit them to the reliable points in the scans.

    Parameters
    ----------
    inverse : InverseProblem
    finer : Model, optional
        A finer mesh of the same body, used to correct for the mesh error.
    each : callable
        Applies a function to every scan; see `workers.diagnosis.fits.gauss_newton.fit`.

    Raises
    ------
    InputError
        If the nominal model cannot be simulated.
    """
    free = unknowns(inverse.free, [])
    first = _fit_from_rest(inverse, free, each)
    if first is None:
        raise InputError(
            "The nominal model could not be solved in the middle of the plausible intervals. "
            "Check the loads, units and constants of the case."
        )
    inverse, first = _reduced(inverse, first, clear(inverse, first))
    if inverse.is_segmented:
        inverse, first = _reduced(inverse, first, _matched(inverse, first))
        starts = [v.at for v in first.predictions]
        first = fit(inverse, free, first.z, starts, each=each) or first
    predictions: Sequence[PredictedScan] = first.predictions
    if inverse.noise.reference_sd_mm > 0:
        inverse = with_pressed_points(inverse, _pressed(inverse, predictions))
        predictions = _compared(inverse, first, predictions)
    if finer is not None:
        inverse = with_mesh_bias(inverse, finer, first, predictions, each)
    columns = first.jacobian * free.sd
    inverse = with_anchored_scans(inverse, [v.points for v in predictions])
    predictions = _compared(inverse, first, predictions)
    inverse = with_learnt_noise(inverse, columns, predictions)
    second = fit(inverse, free, first.z, [v.at for v in predictions], each=each)
    if second is None:
        raise AssertionError("a fit that starts at the optimum of another fit must be simulable")
    return inverse, second


def _fit_from_rest(inverse: InverseProblem, free: Unknowns, each: Each) -> SolvedFit | None:
    """Return a fit from the middle of the intervals, or else from stiffer constants.

    A body that is much too soft may snap into a shape from which no small step leads back: the fit
    then ends farther from the scans than the body at rest.
    """
    rest = [None] * len(inverse.scans)
    first = fit(inverse, free, free.mean, rest, each=each)
    if first is not None:
        fitted_mm, undeformed_mm = distances_mm(inverse, first)
        if fitted_mm < undeformed_mm:
            return first
    stiffer = fit(inverse, free, (free.mean + free.upper) / 2, rest, each=each)
    fits = [one for one in (first, stiffer) if one is not None]
    return min(fits, key=lambda one: one.cost, default=None)


def distances_mm(inverse: InverseProblem, at: Fit) -> tuple[float, float]:
    """Return the root mean square distances from the scans to a fit and to the body at rest."""
    rest = [
        scan.compare(inverse.followed(scan).points, inverse.points)[0] for scan in inverse.scans
    ]
    fitted = [one.residual for one in at.predictions]

    def rms(distances: list[FloatArray]) -> float:
        return float(np.sqrt(np.mean(np.concatenate(distances)[inverse.is_place] ** 2)))

    return rms(fitted), rms(rest)


def _reduced(
    inverse: InverseProblem, at: SolvedFit, kept: BoolArray
) -> tuple[InverseProblem, SolvedFit]:
    """Return the problem and its fit for a subset of the points, given as a mask of shape (k,)."""
    rows = np.tile(kept, len(inverse.scans))
    inverse = inverse.keeping(kept)
    predictions = tuple(_compared(inverse, at, at.predictions))
    return inverse, replace(at, predictions=predictions, jacobian=at.jacobian[rows])


def _matched(inverse: InverseProblem, at: SolvedFit) -> BoolArray:
    """Find points with a counterpart in every scan, whatever may move them, shape (k,)."""
    field, centre_mm = inverse.something_else, inverse.frame.centre_mm
    moved, normals = [v.points for v in at.predictions], [v.normals for v in at.predictions]
    smooth = smooth_columns(
        np.tile(inverse.points.points, (len(inverse.scans), 1)),
        np.concatenate(normals),
        inverse.rows,
        np.full(len(inverse.rows), max(field.amplitudes_mm)),
        field.middle_length_mm,
        field.state_correlation.between(inverse.directions),
        SETTINGS.smooth_field.rank_tolerance,
    )
    poses = pose_columns(moved, normals, centre_mm, *inverse.pose_sd)
    columns = np.hstack([at.jacobian * at.unknowns.sd, poses])
    beside_mm = SETTINGS.unmatched.beside_lengths * field.middle_length_mm
    left = residuals(inverse, at.predictions)
    return matched(inverse.points, inverse.covariance, columns, smooth, left, beside_mm)


def _pressed(inverse: InverseProblem, predictions: Sequence[PredictedScan]) -> list[FloatArray]:
    """Return the share of each point that is pressed by plates in each scan, shapes (k,)."""
    nodes = [inverse.forward.pressed(v.at) for v in predictions]
    free = np.zeros(len(inverse.points))
    return [free if one is None else pressed_shares(inverse, one) for one in nodes]


def _compared(
    inverse: InverseProblem, at: Fit, solved: Sequence[PredictedScan]
) -> list[PredictedScan]:
    """Compare solved predictions with the scans again after a change to the problem."""
    return [
        compare_with_scan(inverse, scan, at.unknowns, at.z, v.at)
        for scan, v in zip(inverse.scans, solved, strict=True)
    ]


def clear(inverse: InverseProblem, at: Fit) -> BoolArray:
    """Find points with no second interface nearby in any deformed scan.

    Two scans of one body are segmented separately; a thin strand or cleft may be in only one of the
    segmentations, and the nearest interface is then a different one.
    """
    reach = SETTINGS.points.clear_noises * inverse.noise.sd_mm
    alone = np.ones(len(inverse.points), np.bool_)
    for scan, v in zip(inverse.scans, at.predictions, strict=True):
        normal = v.normals / np.maximum(np.linalg.norm(v.normals, axis=1), 1e-9)[:, None]
        foot = v.points - v.residual[:, None] * normal
        for side in (-reach, reach):
            away, _ = scan.compare(foot + side * normal, inverse.points)
            alone &= np.abs(away - side) < SETTINGS.points.clear_slack * reach
    return alone


def with_mesh_bias(
    inverse: InverseProblem,
    finer: Model,
    at: Fit,
    predictions: Sequence[PredictedScan],
    each: Each = map,
) -> InverseProblem:
    """Correct for the shift of the points between this mesh and a finer one."""
    fine_problem = replace(inverse, model=finer, at_points=interpolation_of(finer, inverse))
    fine_problem = with_pressed_points(fine_problem, [v.followed.pressed for v in predictions])

    def predicted(scan: Scan) -> PredictedScan | None:
        return predict_scan(fine_problem, scan, at.unknowns, at.z, None)

    bias = []
    for fine, coarse in zip(each(predicted, fine_problem.scans), predictions, strict=True):
        if fine is None:
            return inverse
        bias.append(-((fine.points - coarse.points) * coarse.normals).sum(axis=1))
    return replace(inverse, bias=np.concatenate(bias))


def with_anchored_scans(inverse: InverseProblem, anchors: Sequence[FloatArray]) -> InverseProblem:
    """Fix the noise of segmented interfaces at its value at the anchors, (k, 3) for each scan."""
    if not inverse.is_segmented:
        return inverse
    length = inverse.noise.correlation_mm
    scans = [
        anchored(scan, anchor, inverse.points, length)
        for scan, anchor in zip(inverse.scans, anchors, strict=True)
    ]
    return replace(inverse, scans=scans, anchors=tuple(anchors))


def with_learnt_noise(
    inverse: InverseProblem, columns: FloatArray, predictions: Sequence[ComparedScan]
) -> InverseProblem:
    """Learn the size of the noise; see `workers.diagnosis.noise.noise_scale`.

    Parameters
    ----------
    inverse : InverseProblem
    columns : ndarray, shape (m, p)
        Derivatives of the residuals with respect to the constants, per prior standard deviation.
    predictions : sequence of ComparedScan
        Predictions of the fit at which the derivatives were taken.
    """
    learnt = stated_noise(inverse, predictions)
    if inverse.is_segmented:
        amplitude, length = SETTINGS.noise.learning_field
        field = smooth_columns(
            np.tile(inverse.points.points, (len(inverse.scans), 1)),
            np.concatenate([prediction.normals for prediction in predictions]),
            inverse.rows,
            np.full(len(inverse.rows), amplitude),
            length,
            SETTINGS.smooth_field.state_correlation.between(inverse.directions),
            SETTINGS.smooth_field.rank_tolerance,
        )
        moved, normals = [v.points for v in predictions], [v.normals for v in predictions]
        poses = pose_columns(moved, normals, inverse.frame.centre_mm, *inverse.pose_sd)
        every = np.hstack([learnt.fixed, learnt.numerical, columns, poses, field])
        residual = residuals(inverse, predictions)
        scales = noise_scales(learnt.stated, learnt.groups, every, residual)
        learnt = replace(learnt, scales=scales)
    return replace(inverse, learnt=learnt, covariance=learnt.covariance)


def interpolation_of(model: Model, inverse: InverseProblem) -> csr_matrix:
    """Return the interpolation matrix from the nodes of another mesh to the points."""
    finest, own = model.finest, inverse.points.points[~inverse.is_force]
    mesh = TetMesh(finest.nodes, finest.elements.tets)
    return at_points_with_forces(interpolation_at_points(mesh, own), int(inverse.is_force.sum()))
