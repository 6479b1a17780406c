"""The nominal model at its optimum, with the noise of the scans and of the mesh known."""

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from storage.errors import InputError
from storage.values import BoolArray, FloatArray, TetMesh
from workers.comparison.observation.noise import correlation
from workers.comparison.observation.point_interpolation import interpolation
from workers.diagnosis.discrepancy import SmoothField
from workers.diagnosis.gauss_newton import Fit, SolvedFit, fit
from workers.diagnosis.inverse_problem import InverseProblem, unknowns
from workers.diagnosis.scan_prediction import PredictedScan, compare_with_scan, predict_scan
from workers.diagnosis.settings import SETTINGS
from workers.mechanics.fem.model import Model


def calibrate(
    inverse: InverseProblem, finer: Model | None = None
) -> tuple[InverseProblem, SolvedFit]:
    """Fit the nominal constants, then once more where the scans can be trusted.

    Parameters
    ----------
    inverse : InverseProblem
    finer : Model, optional
        A finer mesh of the same body: what it moves the points by is taken off.

    Raises
    ------
    InputError
        If the nominal model cannot be simulated.
    """
    free = unknowns(inverse.free, [])
    first = fit(inverse, free, free.mean, [None] * len(inverse.scans))
    if first is None:
        raise InputError(
            "The nominal model was not solved at the middle of the plausible intervals: "
            "check loads, units and constants of the case."
        )
    kept = clear(inverse, first)
    inverse = inverse.keeping(kept)
    predictions = [
        compare_with_scan(inverse, scan, free, first.z, v.at)
        for scan, v in zip(inverse.scans, first.predictions, strict=True)
    ]
    inverse = with_common_error(inverse)
    if finer is not None:
        inverse = with_mesh_error(inverse, finer, first, predictions)
    second = fit(inverse, free, first.z, [v.at for v in predictions])
    if second is None:
        raise AssertionError("the start of the second fit is the end of the first")
    return inverse, second


def clear(inverse: InverseProblem, at: Fit) -> BoolArray:
    """Return points whose interface is alone in every deformed scan, where the model puts them.

    Two scans of one body are segmented apart; a thin strand or cleft may be in one of
    them only, and the nearest interface is then another one.
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


def with_common_error(inverse: InverseProblem) -> InverseProblem:
    """Add that an interface, or a region of it, may be drawn a little too large or small."""
    noise = inverse.noise
    own = np.tile(inverse.points.interface, len(inverse.scans))
    common = (SETTINGS.noise.common * noise.sd_mm) ** 2 * (own[:, None] == own)
    smooth = correlation(inverse.points, SETTINGS.noise.smoother_lengths * noise.correlation_mm)
    each = np.kron(
        np.eye(len(inverse.scans)), (SETTINGS.noise.smoother * noise.sd_mm) ** 2 * smooth
    )
    return replace(inverse, covariance=inverse.covariance + common + each)


def with_mesh_error(
    inverse: InverseProblem, finer: Model, at: Fit, predictions: list[PredictedScan]
) -> InverseProblem:
    """Take off what a finer mesh moves the points by, and add what that leaves unknown."""
    to_points = interpolation_of(finer, inverse)
    bias = []
    for scan, coarse in zip(inverse.scans, predictions, strict=True):
        fine = predict_scan(
            replace(inverse, model=finer, at_points=to_points), scan, at.unknowns, at.z, None
        )
        if fine is None:
            return inverse
        bias.append(-((fine.points - coarse.points) * coarse.normals).sum(axis=1))
    b: FloatArray = np.concatenate(bias)
    normals = np.concatenate([v.normals for v in predictions])
    points = np.tile(inverse.points.points, (len(inverse.scans), 1))
    smooth = SmoothField().covariance(points, normals, inverse.rows, SETTINGS.mesh.error_length_mm)
    return replace(inverse, bias=b, covariance=inverse.covariance + (b**2).mean() * smooth)


def interpolation_of(model: Model, inverse: InverseProblem) -> csr_matrix:
    """Return the matrix from displacements of another mesh's nodes to those of the points."""
    finest = model.finest
    return interpolation(TetMesh(finest.nodes, finest.elements.tets), inverse.points.points)
