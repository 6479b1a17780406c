"""A world in which everything is linear and normal, so the truth is known exactly.

Points are on an ellipsoid with half axes of 60 x 40 x 30 mm, observed in two states. A mode is a
displacement field, polynomial in the position and observed along the normals; it grows with the
load of the state as a power that differs between modes.
"""

from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis, screen
from palpate.workers.diagnosis.laplace_evidence import log_evidence
from palpate.workers.diagnosis.linearisation import EffectSensitivity, Linearised, factored
from palpate.workers.diagnosis.noise.noise_components import smooth_covariance
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis, advance, diagnose
from palpate.workers.diagnosis.verdict.joint_fit import JointFit

HALF_AXES_MM = np.array([60.0, 40.0, 30.0])
LOADS = np.array([0.6, 1.0])
NOISE_MM, REFERENCE_MM, NUGGET_MM, CORRELATION_MM = 0.25, 0.12, 0.08, 6.0


def ellipsoid(k):
    """Return points spread by the golden angle, and their unit normals."""
    z = 1 - 2 * (np.arange(k) + 0.5) / k
    turn = np.pi * (1 + 5**0.5) * np.arange(k)
    across = np.sqrt(1 - z**2)
    sphere = np.c_[across * np.cos(turn), across * np.sin(turn), z]
    normals = sphere / HALF_AXES_MM
    return sphere * HALF_AXES_MM, normals / np.linalg.norm(normals, axis=1)[:, None]


def layout(k):
    """Return the point, normal and state of every residual."""
    points, normals = ellipsoid(k)
    states = np.repeat(np.arange(len(LOADS)), k)
    return np.tile(points, (2, 1)), np.tile(normals, (2, 1)), states


def noise_covariance(k):
    """Return reference noise shared by all states, plus a smooth part and a nugget in each."""
    points, _ = ellipsoid(k)
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    smooth = np.exp(-0.5 * (distance / CORRELATION_MM) ** 2)
    each = NOISE_MM**2 * smooth + NUGGET_MM**2 * np.eye(k)
    return np.kron(np.ones((2, 2)), REFERENCE_MM**2 * smooth) + np.kron(np.eye(2), each)


def mode(k, powers, axis, load_power):
    """Return the displacement x^a y^b z^c along an axis, 1 mm (rms) at full load, shape (m,)."""
    points, normals, states = layout(k)
    seen = np.prod((points / HALF_AXES_MM) ** powers, axis=1) * normals[:, axis]
    return seen / np.sqrt((seen**2).mean()) * LOADS[states] ** load_power


@cache
def nominal_problem(k=60):
    """Return a problem with three parameters at their prior means and zero residual."""
    columns = np.c_[
        mode(k, (1, 0, 0), 0, 1.0), mode(k, (0, 1, 0), 1, 1.0), mode(k, (0, 0, 1), 2, 2.0)
    ]
    m = len(columns)
    factor = factored(noise_covariance(k))
    return Linearised(np.zeros(m), columns, np.array([0.5, 2.0, 1.0]), np.zeros(3), factor)


def effect(name, columns, sd=1.0, one_sided=False, family=None):
    """Return a sensitivity with one scale for all parameters."""
    columns = np.asarray(columns, dtype=float)
    columns = columns[:, None] if columns.ndim == 1 else columns
    q = columns.shape[-1]
    sided = np.full(q, one_sided)
    return EffectSensitivity(name, family or name, columns, np.full(q, float(sd)), sided)


@cache
def catalogue(k=60):
    """Return six effects: two with two parameters, one one-sided, one at any of four places."""
    spots = [np.array(c) for c in ((30, 20, 15), (-30, 20, 15), (30, -20, -15), (-30, 20, -15))]
    points, _, states = layout(k)
    bumps = [np.exp(-0.5 * ((points - c) ** 2).sum(axis=1) / 15.0**2) for c in spots]
    lesion = 2.0 * np.stack(bumps)[:, :, None] * LOADS[states][:, None]
    gravity = np.c_[mode(k, (0, 0, 0), 0, 0), mode(k, (0, 0, 0), 1, 0)]
    gradient = np.c_[mode(k, (2, 1, 0), 1, 1.0), mode(k, (0, 2, 1), 2, 1.0)]
    return (
        effect("gravity", gravity, 0.3, family="loading"),
        effect("tilt", mode(k, (0, 1, 1), 0, 1.0), 0.5, family="plate geometry"),
        effect("friction", mode(k, (2, 0, 0), 1, 1.5), 0.5, True, "boundary"),
        effect("gradient", gradient, 0.4, family="material"),
        effect("stiffening", mode(k, (0, 0, 3), 2, 3.0), 0.5, family="material"),
        effect("inclusion", lesion, 1.0, family="local stiffness"),
    )


FIELD = SETTINGS.smooth_field


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fit of the constants and of some effects: the same linear model everywhere.

    It has what a diagnosis uses of a `Fit`.
    """

    linear: Linearised
    one_sided: np.ndarray
    predictions: tuple = ()

    @property
    def at_bound(self):
        return np.zeros(len(self.one_sided), np.int32)

    def linearised(self, inverse):
        return self.linear

    linearised_with_poses = linearised

    def log_evidence(self, inverse, columns=None, part=None):
        q = 0 if columns is None else columns.shape[1]
        linear = self.linear if columns is None else self.linear.freed(columns, np.ones(q))
        linear = linear if part is None else linear.of(part.rows, part.factor)
        return log_evidence(linear, np.append(self.one_sided, np.zeros(q, bool)))


def linear_analysis(problem, sensitivities, amplitudes_mm=FIELD.amplitudes_mm):
    """Return the nominal analysis of a problem with known noise, whose residual may be any."""
    k = problem.size // 2
    points, normals, states = layout(k)
    seen = tuple(SimpleNamespace(normals=normals[states == s]) for s in (0, 1))
    nominal = LinearFit(problem, np.zeros(len(problem.nominal_sd), bool), seen)
    inverse = SimpleNamespace(
        is_segmented=True,
        points=SimpleNamespace(points=points[:k]),
        scans=[None, None],
        rows=states,
        directions=np.tile([0.0, 0.0, 1.0], (2, 1)),
        something_else=replace(FIELD, amplitudes_mm=amplitudes_mm),
    )
    return NominalAnalysis(inverse, nominal, sensitivities)


def linear_fit(problem, sensitivities):
    """Return the fit of the constants with some effects, each at its best place."""
    linear, sided = problem, np.zeros(len(problem.nominal_sd), bool)
    for one in sensitivities:
        columns = one.places[screen(linear, [one])[0].place]
        linear = linear.freed(columns, one.prior_sd)
        sided = np.append(sided, one.one_sided)
    return LinearFit(linear, sided)


def linear_diagnosis(problem, sensitivities):
    """Return the diagnosis of a problem, with every requested fit computed."""
    by_name = {one.name: one for one in sensitivities}
    known = [SimpleNamespace(name=name, place=None) for name in by_name]
    analysis = linear_analysis(problem, sensitivities)
    course = diagnose(analysis, known)
    reached = advance(course)
    while not isinstance(reached, Diagnosis):
        fits = []
        for effects in reached:
            fitted = linear_fit(problem, [by_name[e.name] for e in effects])
            fits.append(JointFit(effects, fitted, fitted.log_evidence(None)))
        reached = advance(course, fits)
    return reached


def observed(problem, rng, signal=0.0):
    """Return the problem with a residual: signal, parameters drawn from their prior, and noise."""
    parameters = problem.nominal_sd * rng.standard_normal(len(problem.nominal_sd))
    noise = problem.covariance_factor @ rng.standard_normal(problem.size)
    return replace(problem, residual=signal - problem.nominal @ parameters + noise)


def signal_of(sensitivity, rng):
    """Return the residual of an effect with parameters drawn from their prior."""
    phi = sensitivity.prior_sd * rng.standard_normal(len(sensitivity.prior_sd))
    phi = np.where(sensitivity.one_sided, np.abs(phi), phi)
    return -sensitivity.places[rng.integers(len(sensitivity.places))] @ phi


def field_draw(k, rng, amplitude_mm=None):
    """Return a smooth field drawn from its prior, or of a given size, along the normals."""
    covariance = smooth_covariance(*layout(k), rng.choice(FIELD.lengths_mm), 0.8)
    factor = np.linalg.cholesky(covariance + 1e-9 * np.eye(len(covariance)))
    size_mm = amplitude_mm or rng.choice(FIELD.amplitudes_mm)
    return size_mm * (factor @ rng.standard_normal(len(factor)))


def dense_log_density(problem, columns=None, sd=(), extra=0.0):
    """Return the log density of the residual with all parameters integrated out.

    It is ``ln N(r; J offset, C + J S J' + extra) + (m/2) ln 2 pi + ln|C|/2``.
    """
    J, scales = problem.nominal, problem.nominal_sd
    mean = J @ problem.nominal_offset
    if columns is not None:
        J, scales = np.hstack([J, columns]), np.append(scales, sd)
    C = problem.covariance_factor @ problem.covariance_factor.T
    total = C + (J * scales**2) @ J.T + extra
    r = problem.residual - mean
    logs = np.linalg.slogdet(total)[1] - np.linalg.slogdet(C)[1]
    return -0.5 * r @ np.linalg.solve(total, r) - 0.5 * logs
