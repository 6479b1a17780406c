"""What errors of the first image do to the simulated deformation.

The mesh is drawn on a section that was segmented. Where that is too thick the cornea is too
stiff, and the jet moves all of it less: an error that is smooth, and larger than the one that
made it. 10 um of thickness are 50 um of displacement.
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

# Waves of the error of the thickness over the section, from one that is the same everywhere.
WAVES = 12
STEP_MM = 1e-4


def geometry_covariance(
    problem: CorneaProblem, noise: SegmentationNoise, at_points: csr_matrix, normals: FloatArray
) -> FloatArray:
    """Return the covariance of the residuals from errors of the thickness, shape (k, k).

    Zero if the problem cannot be solved.

    Parameters
    ----------
    problem : CorneaProblem
        With constants near those of the eye.
    noise : SegmentationNoise
        Of which the errors in the first image count, of both surfaces.
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
    """Return the standard deviation of the coefficient of a cosine in the error of thickness.

    Of an error with the correlation ``exp(-h^2 / 2 l^2)`` over a length L, from its spectrum:
    ``sd^2 l sqrt(2 pi) / L exp(-(pi k l / L)^2 / 2)``, twice that for k > 0.
    """
    length = float(np.ptp(candidate.prepared.mesh.nodes_mm[:, 0]))
    scale = noise.correlation_mm
    power = (
        np.sqrt(2 * np.pi) * scale / length * np.exp(-0.5 * (np.pi * wave * scale / length) ** 2)
    )
    both = 2 * noise.reference_sd_mm**2 * power * (2 if wave else 1)
    return float(np.sqrt(both))
