"""The nominal model at its optimum, with the noise of the scans and of the mesh known."""

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from storage.errors import InputError
from storage.values import BoolArray, FloatArray, TetMesh
from workers.diagnosis.discrepancy import SmoothField
from workers.diagnosis.fit import Fit, fit
from workers.diagnosis.subject import Subject, unknowns
from workers.diagnosis.views import View, seen, view
from workers.fem.model import Model
from workers.observation.locate import interpolation
from workers.observation.noise import correlation

# Standard deviations of the segmentation that an interface must be alone in, in a
# deformed scan, for a point that the model puts there.
CLEAR_NOISES = 5.0
# Of that reach, by which the distance may differ: curvature and blur.
SLACK = 0.1
# An interface as a whole may be drawn too large or too small by this, in standard
# deviations of the segmentation: points were chosen on one noisy scan. On bodies that lack
# nothing, means over an interface and all scans scatter by 0.08 to 0.15 of them in all.
COMMON_NOISES = 0.1
# A part of every scan's noise is smoother than its correlation length says: on scans segmented
# with a known noise, smooth sums of residuals scatter 1.25 times as much as they should.
SMOOTHER_NOISES, SMOOTHER_LENGTHS = 0.25, 3.0
# What is still unknown after the difference to a finer mesh is taken off is believed to be
# as large as the difference itself, and smooth over this length.
MESH_LENGTH_MM = 16.0


def calibrate(subject: Subject, finer: Model | None = None) -> tuple[Subject, Fit]:
    """Fit the nominal constants, then once more where the scans can be trusted.

    Parameters
    ----------
    subject : Subject
    finer : Model, optional
        A finer mesh of the same body: what it moves the points by is taken off.

    Raises
    ------
    InputError
        If the nominal model cannot be simulated.
    """
    free = unknowns(subject.free, [])
    first = fit(subject, free, free.mean, [None] * len(subject.scans))
    if first is None:
        raise InputError(
            "The nominal model was not solved at the middle of the plausible intervals: "
            "check loads, units and constants of the case."
        )
    kept = clear(subject, first)
    subject = subject.keeping(kept)
    views = [
        seen(subject, scan, free, first.z, v.at)
        for scan, v in zip(subject.scans, first.views, strict=True)
    ]
    subject = with_common_error(subject)
    if finer is not None:
        subject = with_mesh_error(subject, finer, first, views)
    second = fit(subject, free, first.z, [v.at for v in views])
    if second is None:
        raise AssertionError("the start of the second fit is the end of the first")
    return subject, second


def clear(subject: Subject, at: Fit) -> BoolArray:
    """Points whose interface is alone in every deformed scan, where the model puts them.

    Two scans of one body are segmented apart; a thin strand or cleft may be in one of
    them only, and the nearest interface is then another one.
    """
    reach = CLEAR_NOISES * subject.noise.sd_mm
    alone = np.ones(len(subject.points), np.bool_)
    for scan, v in zip(subject.scans, at.views, strict=True):
        normal = v.normals / np.maximum(np.linalg.norm(v.normals, axis=1), 1e-9)[:, None]
        foot = v.points - v.residual[:, None] * normal
        for side in (-reach, reach):
            away, _ = scan.look(foot + side * normal, subject.points)
            alone &= np.abs(away - side) < SLACK * reach
    return alone


def with_common_error(subject: Subject) -> Subject:
    """An interface as a whole, or a region of it, may be drawn a little too large or small."""
    noise = subject.noise
    own = np.tile(subject.points.interface, len(subject.scans))
    common = (COMMON_NOISES * noise.sd_mm) ** 2 * (own[:, None] == own)
    smooth = correlation(subject.points, SMOOTHER_LENGTHS * noise.correlation_mm)
    each = np.kron(np.eye(len(subject.scans)), (SMOOTHER_NOISES * noise.sd_mm) ** 2 * smooth)
    return replace(subject, covariance=subject.covariance + common + each)


def with_mesh_error(subject: Subject, finer: Model, at: Fit, views: list[View]) -> Subject:
    """Take off what a finer mesh moves the points by, and add what that leaves unknown."""
    to_points = interpolation_of(finer, subject)
    bias = []
    for scan, coarse in zip(subject.scans, views, strict=True):
        fine = view(
            replace(subject, model=finer, at_points=to_points), scan, at.unknowns, at.z, None
        )
        if fine is None:
            return subject
        bias.append(-((fine.points - coarse.points) * coarse.normals).sum(axis=1))
    b: FloatArray = np.concatenate(bias)
    normals = np.concatenate([v.normals for v in views])
    points = np.tile(subject.points.points, (len(subject.scans), 1))
    smooth = SmoothField().covariance(points, normals, subject.rows, MESH_LENGTH_MM)
    return replace(subject, bias=b, covariance=subject.covariance + (b**2).mean() * smooth)


def interpolation_of(model: Model, subject: Subject) -> csr_matrix:
    """From displacements of the finest nodes of another mesh to those of the points."""
    finest = model.finest
    return interpolation(TetMesh(finest.nodes, finest.elements.tets), subject.points.points)
