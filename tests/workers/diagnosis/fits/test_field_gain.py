"""The evidence for a smooth field, compared with dense normal densities."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp

from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis
from palpate.workers.diagnosis.fits.gauss_newton import Fit
from palpate.workers.diagnosis.noise.noise_components import (
    LearntNoise,
    drawing_columns,
    pose_columns,
    smooth_columns,
)
from palpate.workers.diagnosis.problem.inverse_problem import (
    FreeConstant,
    InverseProblem,
    Scan,
    unknowns,
)
from palpate.workers.diagnosis.problem.scan_prediction import ComparedScan
from palpate.workers.mechanics.fem.boundary_value_problem import Frame
from tests.workers.diagnosis.linear_world import (
    FIELD,
    HALF_AXES_MM,
    dense_log_density,
    ellipsoid,
    field_draw,
    layout,
    linear_analysis,
    linear_fit,
    mode,
    nominal_problem,
    observed,
)
from tests.workers.diagnosis.linear_world import effect as sensitivity

K = 60
OFFSET = np.array([0.2, -0.5, 0.4])


def posed(residual, has_poses=True):
    """Return an analysis of residuals with poses, contour bias and a numerical error."""
    points, normals = ellipsoid(K)
    problem = nominal_problem(K)
    interface = (points[:, 2] < 0).astype(np.int32)
    groups = np.tile(interface, 2)
    learnt = LearntNoise(
        problem.covariance * (groups[:, None] == groups),
        groups,
        drawing_columns(interface, 2, 0.03, 0.05),
        smooth_columns(*layout(K), np.full(2 * K, 0.05), 12.0, 0.5, 1e-8),
        np.array([1.2, 0.8]),
    )
    free = [
        FreeConstant(name, float(np.exp(-sd)), float(np.exp(sd)))
        for name, sd in zip("abc", problem.nominal_sd, strict=True)
    ]
    nothing = None
    inverse = InverseProblem(
        nothing,
        Frame((0.0, 0.0, 0.0), tuple(HALF_AXES_MM)),
        InterfacePoints(points, normals, interface, np.ones(K), np.zeros(K, np.int32)),
        nothing,
        free,
        [Scan(name, lambda values: None, nothing) for name in ("low", "high")],
        SegmentationNoise(0.25, 6.0, 0.12, 0.08),
        learnt.covariance,
        np.zeros(2 * K),
        is_segmented=has_poses,
        learnt=learnt,
        forward=SimpleNamespace(direction=lambda problem: (0.0, 0.0, 1.0)),
    )
    compared = tuple(ComparedScan(points, r, normals) for r in residual.reshape(2, K))
    fit = Fit(unknowns(free, []), OFFSET, compared, problem.nominal, 0.0, True, 1)
    return NominalAnalysis(inverse, fit, [])


def log_density(analysis, residual, extra=0.0):
    """Return ln N(r; J offset, C + poses + constants + extra), up to a constant."""
    inverse, problem = analysis.inverse, nominal_problem(K)
    J, sd = problem.nominal, problem.nominal_sd
    points, normals = ellipsoid(K)
    covariance = inverse.learnt.covariance + (J * sd**2) @ J.T + extra
    if inverse.is_segmented:
        poses = pose_columns([points] * 2, [normals] * 2, (0.0, 0.0, 0.0), *inverse.pose_sd)
        covariance = covariance + poses @ poses.T
    r = residual - J @ OFFSET
    return -0.5 * r @ np.linalg.solve(covariance, r) - 0.5 * np.linalg.slogdet(covariance)[1]


@pytest.mark.parametrize("has_poses", [True, False])
def test_field_gain_is_a_ratio_of_dense_densities(has_poses):
    """Densities are averaged over all lengths and amplitudes of the field."""
    rng = np.random.default_rng(21)
    residual = observed(nominal_problem(K), rng, field_draw(K, rng)).residual
    analysis = posed(residual, has_poses)
    with_field = [
        log_density(analysis, residual, amplitude**2 * F @ F.T)
        for F in analysis.fields
        for amplitude in FIELD.amplitudes_mm
    ]
    assert len(with_field) == 9
    expected = logsumexp(with_field) - np.log(9) - log_density(analysis, residual)
    assert analysis.field_gain(analysis.nominal) == pytest.approx(expected, abs=1e-7)


def test_evidences_differ_by_as_much_as_dense_densities():
    """Differences between residuals are those of dense densities."""
    rng = np.random.default_rng(22)
    first, second = (observed(nominal_problem(K), rng).residual for _ in range(2))
    evidences = [posed(r).log_evidence for r in (first, second)]
    dense = [log_density(posed(r), r) for r in (first, second)]
    assert np.diff(evidences) == pytest.approx(np.diff(dense), abs=1e-8)


def test_field_gain_of_a_fit_is_in_addition_to_its_effects():
    """A field explains what an effect leaves."""
    rng = np.random.default_rng(23)
    listed = sensitivity("tilt", mode(K, (0, 1, 1), 0, 1.0))
    signal = field_draw(K, rng, amplitude_mm=0.8) - listed.columns[:, 0]
    problem = observed(nominal_problem(K), rng, signal)
    analysis = linear_analysis(problem, [listed])
    fitted = linear_fit(problem, [listed])
    gains = []
    for F in analysis.fields:
        for amplitude in FIELD.amplitudes_mm:
            extra = amplitude**2 * F @ F.T
            gains.append(dense_log_density(problem, listed.columns, listed.prior_sd, extra))
    alone = dense_log_density(problem, listed.columns, listed.prior_sd)
    expected = logsumexp(gains) - np.log(9) - alone
    assert analysis.field_gain(fitted) == pytest.approx(expected, abs=1e-7)
    assert 10 < expected < analysis.field_gain(analysis.nominal)


def test_a_field_gains_from_a_smooth_displacement_but_not_from_noise():
    rng = np.random.default_rng(24)
    fields, none = [], []
    for _ in range(20):
        fields.append(observed(nominal_problem(K), rng, field_draw(K, rng, amplitude_mm=0.8)))
        none.append(observed(nominal_problem(K), rng))
    gains, nothing = (
        np.array([a.field_gain(a.nominal) for a in (linear_analysis(p, []) for p in some)])
        for some in (fields, none)
    )
    assert gains.min() > 20
    assert -5 < nothing.min() < nothing.max() < 3
    assert nothing.mean() < 0


def test_a_pose_error_is_no_evidence_for_a_field():
    """Scans 0.4 mm and 0.4 degrees apart give tens of nats without poses, none with poses."""
    rng = np.random.default_rng(64)
    points, normals = ellipsoid(K)
    poses = pose_columns([points] * 2, [normals] * 2, (0.0, 0.0, 0.0), 0.4, 0.4)
    residual = observed(nominal_problem(K), rng, poses @ rng.standard_normal(12)).residual
    known, ignorant = posed(residual), posed(residual, has_poses=False)
    assert ignorant.field_gain(ignorant.nominal) > 20
    assert known.field_gain(known.nominal) < 2


def test_no_field_gains_nothing():
    problem = observed(nominal_problem(K), np.random.default_rng(25))
    analysis = linear_analysis(problem, [], amplitudes_mm=(1e-6,))
    assert analysis.field_gain(analysis.nominal) == pytest.approx(0.0, abs=1e-6)
