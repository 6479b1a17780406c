"""Errors of the simulated deformation that are due to errors of the first image.

The mesh follows a segmented section. Where that is too thick the cornea is too stiff, and the
jet moves all of it less: an error that is smooth and larger than its cause. 10 um of thickness
change the displacement by 50 um.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.values import FloatArray
from palpate.workers.comparison.observation.noise import SegmentationNoise
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Change
from palpate.workers.organs.cornea.diagnosis.diagnosed_problem import CorneaForward, CorneaProblem
from palpate.workers.organs.cornea.solver.candidate import Candidate
from palpate.workers.organs.cornea.solver.prepared_mesh import prepare
from palpate.workers.organs.cornea.solver.thickness import deeper

# Cosine modes of the thickness error along the section, starting with the constant one.
WAVES = 12
STEP_MM = 1e-4


def geometry_covariance(
    problem: CorneaProblem, noise: SegmentationNoise, at_points: csr_matrix, normals: FloatArray
) -> FloatArray:
    """Return the covariance of the residuals due to errors of the thickness, shape (k, k).

    Zero if the problem cannot be solved.

    Parameters
    ----------
    problem : CorneaProblem
        A problem with approximately the constants of the eye.
    noise : SegmentationNoise
        Its errors of both surfaces in the first image are used.
    at_points : csr_matrix, shape (k, n)
    normals : ndarray, shape (k, 3)
    """
    solver = CorneaForward()
    at = solver.equilibrium(None, problem)
    empty = np.zeros((len(normals), len(normals)))
    if noise.reference_sd_mm == 0 or not at.solution.outcome.converged:
        return empty
    columns, sd = [], []
    for wave, nodal in enumerate(solver.tangents(at, _changes(problem))):
        columns.append(((at_points @ nodal) * normals).sum(axis=1))
        sd.append(_sd_of_wave(problem.candidate, noise, wave))
    A = np.stack(columns, axis=1) * np.array(sd)
    return np.asarray(A @ A.T)


def _changes(problem: CorneaProblem) -> Sequence[Change]:
    changes = []
    for wave in range(WAVES):
        plus: Any = replace(problem, candidate=_waved(problem.candidate, wave, 1))
        minus: Any = replace(problem, candidate=_waved(problem.candidate, wave, -1))
        changes.append(Change(plus, minus, 2 * STEP_MM))
    return changes


def _waved(candidate: Candidate, wave: int, sign: int) -> Candidate:
    """Return a candidate that is thicker by a cosine along the section."""
    prepared = candidate.prepared
    x = prepared.mesh.nodes_mm
    moved = deeper(prepared.mesh, sign * STEP_MM) - x
    mesh = replace(prepared.mesh, nodes_mm=x + _cosine(x[:, 0], wave)[:, None] * moved)
    return replace(candidate, prepared=prepare(mesh, prepared.model))


def _cosine(x: FloatArray, wave: int) -> FloatArray:
    return np.asarray(np.cos(np.pi * wave * (x - x.min()) / np.ptp(x)))


def _sd_of_wave(candidate: Candidate, noise: SegmentationNoise, wave: int) -> float:
    """Return the standard deviation of the coefficient of a cosine in the thickness error.

    For an error with the correlation ``exp(-h^2 / 2 l^2)`` over a length L its spectrum gives
    ``sd^2 l sqrt(2 pi) / L exp(-(pi k l / L)^2 / 2)``, twice that for k > 0.
    """
    length = float(np.ptp(candidate.prepared.mesh.nodes_mm[:, 0]))
    scale = noise.correlation_mm
    power = (
        np.sqrt(2 * np.pi) * scale / length * np.exp(-0.5 * (np.pi * wave * scale / length) ** 2)
    )
    both = 2 * noise.reference_sd_mm**2 * power * (2 if wave else 1)
    return float(np.sqrt(both))
