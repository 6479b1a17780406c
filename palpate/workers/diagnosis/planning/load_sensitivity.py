r"""Sensitivity of a planned scan to constants and effects, computed from the model alone.

The normals of the loaded interfaces come from the model: with the deformation gradient F, a normal
n of the body at rest becomes

.. math:: n' = F^{-T} n / |F^{-T} n|

(E. J. Nanson, Messenger of Math. 7 (1878) 182). An additional row is the distance between the
plates: the relative motion of the contact areas, with each node weighted by its contact stiffness.
For flat plates under a given force, this is the reduction in plate travel, apart from the
penetration allowed by the penalty.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, vstack

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.diagnosis.fits.gauss_newton import SolvedFit
from palpate.workers.diagnosis.fits.sensitivity_analysis import scan_sensitivity
from palpate.workers.diagnosis.problem.acquisition import INTERFACES, ProblemBuilder
from palpate.workers.diagnosis.problem.inverse_problem import (
    InverseProblem,
    Scan,
    Unknowns,
    unknowns,
)
from palpate.workers.diagnosis.problem.scan_prediction import PredictedScan, columns_of
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.fem.elements.model import LevelModel
from palpate.workers.mechanics.fem.equilibrium.solve import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Change
from palpate.workers.mechanics.fem.problem.loads import NoPlates

# Interface number of the row with the plate distance.
PLATES = len(INTERFACES)


@dataclass(frozen=True, eq=False)
class LoadSensitivity:
    """Derivatives of the data of a scan, at the prior mean of the constants.

    The rows are the k points on the interfaces, in mm along their normals, then the distance
    between the plates in mm.

    Parameters
    ----------
    nominal : ndarray, shape (k + 1, p)
        Derivatives with respect to the logarithms of the constants.
    columns : dict of str to ndarray, shape (k + 1, q) or (g, k + 1, q)
        Derivatives with respect to the parameters of each effect; zero if it does not act under
        this load.
    travel_mm : float
        Travel of the plates towards each other; 0 if their distance is given.
    """

    nominal: FloatArray
    columns: dict[str, FloatArray]
    travel_mm: float


def load_sensitivity(
    unloaded: InverseProblem, name: str, problem: ProblemBuilder, effects: Sequence[Effect]
) -> LoadSensitivity | None:
    """Simulate one load and differentiate the predicted data of its scan.

    Parameters
    ----------
    unloaded : InverseProblem
        The body at rest; see `workers.diagnosis.problem.acquisition.inverse_problem_of`.
    name : str
        Name of the load.
    problem : callable
    effects : sequence of Effect

    Returns
    -------
    LoadSensitivity or None
        None if the nominal model does not converge under this load. Effects that cannot be
        simulated have no columns.
    """
    free = unknowns(unloaded.free, [])
    nominal = problem(free.constants(free.mean))
    at = equilibrium(unloaded.model, nominal)
    if not at.solution.outcome.converged:
        return None
    scan = Scan(name, problem, _not_scanned)
    inverse, prediction = _with_plates(unloaded, scan, at)
    fit = SolvedFit(free, free.mean, (prediction,), np.empty((0, 0)), 0.0, True, 0)
    columns = {}
    for effect in effects:
        found = _columns(inverse, fit, effect)
        if found is not None:
            columns[effect.name] = found
    jacobian = columns_of(inverse, prediction, _changes(problem, free))
    return LoadSensitivity(jacobian, columns, at.states[-1].travel_mm)


def deformed_normals(unloaded: InverseProblem, displacement_mm: FloatArray) -> FloatArray:
    """Return the normals of the interfaces after a displacement of the nodes, shape (k, 3)."""
    gradients = nodal_gradients(unloaded.model.finest, displacement_mm)
    at_points = unloaded.at_points @ gradients.reshape(len(gradients), 9)
    F = at_points.reshape(-1, 3, 3)
    turned = np.linalg.solve(F.transpose(0, 2, 1), unloaded.points.normals[:, :, None])[:, :, 0]
    return np.asarray(turned / np.linalg.norm(turned, axis=1)[:, None])


def nodal_gradients(level: LevelModel, displacement_mm: FloatArray) -> FloatArray:
    """Return nodal means of the elements' deformation gradients, shape (n, 3, 3)."""
    tets, gradients, volumes = level.elements
    u = displacement_mm[tets]
    F = np.eye(3) + np.einsum("mai,maj->mij", u[:, 1:] - u[:, :1], gradients)
    total = np.zeros((len(level.nodes), 9))
    weight = np.zeros(len(level.nodes))
    for corner in tets.T:
        np.add.at(total, corner, volumes[:, None] * F.reshape(-1, 9))
        np.add.at(weight, corner, volumes)
    return np.asarray((total / weight[:, None]).reshape(-1, 3, 3))


def plate_row(at: Equilibrium) -> tuple[csr_matrix, FloatArray]:
    """Return the relative motion of both plates' contact areas, as a row for the nodes.

    Returns
    -------
    csr_matrix, shape (1, n)
        Weights of the nodes, with a sum of 1 for the upper plate and -1 for the lower; all zero
        without plates.
    ndarray, shape (3,)
        The axis from the lower to the upper plate.
    """
    level, state, load = at.levels[-1], at.states[-1], at.problem.load
    n = len(level.model.nodes)
    if isinstance(load, NoPlates):
        return csr_matrix((1, n)), np.array([0.0, 1.0, 0.0])
    weights = np.zeros(n)
    for plate, sign in zip(level.plate_contacts(state, at.stage), (-1.0, 1.0), strict=True):
        touching = plate.nodes.stiffness * (plate.gap < 0)
        if touching.any():
            weights[plate.nodes.index] += sign * touching / touching.sum()
    axis = np.asarray(load.device.axis)
    return csr_matrix(weights[None]), axis / np.linalg.norm(axis)


def _changes(problem: ProblemBuilder, free: Unknowns) -> list[Change]:
    """Return the changes in the logarithm of each constant, about the prior mean."""
    found = []
    for step in SETTINGS.fit.log_step * np.eye(len(free.mean)):
        ahead, behind = (problem(free.constants(free.mean + s)) for s in (step, -step))
        found.append(Change(ahead, behind, 2 * SETTINGS.fit.log_step))
    return found


def _with_plates(
    unloaded: InverseProblem, scan: Scan, at: Equilibrium
) -> tuple[InverseProblem, PredictedScan]:
    """Return the problem with the plate distance as a further point, and its prediction."""
    row, axis = plate_row(at)
    u, p = at.solution.displacement_mm, unloaded.points
    points = InterfacePoints(
        np.vstack([p.points, unloaded.frame.centre_mm]),
        np.vstack([p.normals, axis]),
        np.append(p.interface, np.int32(PLATES)),
        np.append(p.area_mm2, 0.0),
        np.append(p.part, p.part.max() + np.int32(1)),
    )
    to_points = csr_matrix(vstack([unloaded.at_points, row]))
    inverse = replace(unloaded, points=points, at_points=to_points, scans=(scan,))
    followed = inverse.followed(scan)
    normals = np.vstack([deformed_normals(unloaded, u), axis])
    return inverse, PredictedScan(followed.moved(u), np.zeros(len(points)), normals, at, followed)


def _columns(inverse: InverseProblem, fit: SolvedFit, effect: Effect) -> FloatArray | None:
    """Return the columns of one effect, zero if it does not act, or None if not simulated."""
    found = scan_sensitivity(inverse, fit, 0, effect)
    if found.idle:
        return np.zeros((len(inverse.points), len(effect.names)))
    columns = found.columns
    if columns is not None and not effect.acts_on_body:
        columns = columns.copy()
        columns[..., -1, :] = 0.0  # the plate distance is not measured in the images
    return columns


def _not_scanned(points: FloatArray, of: InterfacePoints) -> tuple[FloatArray, FloatArray]:
    raise InputError("This scan is only planned, so it cannot be compared with a model.")
