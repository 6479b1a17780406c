"""Sensitivities of the nominal fit's residuals to every effect in a catalogue.

A localised effect is evaluated at a grid of candidate places.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.gauss_newton import SolvedFit
from palpate.workers.diagnosis.linearisation import EffectSensitivity
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.scan_prediction import (
    PredictedScan,
    columns_of,
    observed_columns,
    problem_of,
)
from palpate.workers.mechanics.effects.effect import Effect, Place, one_sided
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.fem.external_forces import spring_stiffness


def places_of(inverse: InverseProblem, effect: Effect) -> FloatArray:
    """Return the grid of places at which an effect is evaluated.

    Parameters
    ----------
    inverse : InverseProblem
    effect : Effect

    Returns
    -------
    ndarray, shape (g, 3) or (g, 4)
        Offsets from the middle of the body in mm, followed by radii in mm if several are tried;
        empty for an effect that acts everywhere.
    """
    where, centre = effect.place, np.asarray(inverse.frame.centre_mm)
    if where is None:
        return np.empty((0, 3))
    if where.on == "inside":
        return _inside(inverse) - centre
    grid_mm = SETTINGS.sensitivities.boundary_grid_mm
    if not where.radii_mm:
        return _on_boundary(inverse, grid_mm) - centre
    least = min(where.radii_mm)
    grids = []
    for radius in where.radii_mm:
        offsets = _on_boundary(inverse, grid_mm * radius / least) - centre
        grids.append(np.column_stack([offsets, np.full(len(offsets), radius)]))
    return np.concatenate(grids)


def starting_places(effect: Effect, places: FloatArray, log_bayes_factors: FloatArray) -> list[int]:
    """Return the indices of places from which to start the fit of an effect, the best first.

    Neighbours on the grid lead to the same optimum, so they are skipped, as are unlikely places.

    Parameters
    ----------
    effect : Effect
    places : ndarray, shape (g, 3) or (g, 4)
        See `places_of`.
    log_bayes_factors : ndarray, shape (g,)
        Log Bayes factor of the effect at each place.
    """
    settings, grid = SETTINGS.joint_fits, SETTINGS.sensitivities
    inside = effect.place is not None and effect.place.on == "inside"
    apart_mm = settings.places_apart * (grid.inside_grid_mm if inside else grid.boundary_grid_mm)
    starts: list[int] = []
    for i in map(int, np.argsort(-log_bayes_factors, kind="stable")):
        if starts and log_bayes_factors[starts[0]] - log_bayes_factors[i] > settings.places_behind:
            break
        if all(np.linalg.norm(places[i, :3] - places[j, :3]) > apart_mm for j in starts):
            starts.append(i)
        if len(starts) == settings.place_starts:
            break
    return starts


def _inside(inverse: InverseProblem) -> FloatArray:
    """Return points inside the body with a spacing of `inside_grid_mm` in the settings."""
    settings = SETTINGS.sensitivities
    nodes = inverse.model.finest.nodes
    spacing = settings.inside_grid_mm
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    axes = [np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    outline = inverse.points.points[inverse.points.interface == 0]
    away, near = (KDTree(points).query(centres)[0] for points in (outline, nodes))
    return np.asarray(centres[(away > settings.inside_depth_mm) & (near < spacing / 2)])


def _on_boundary(inverse: InverseProblem, spacing_mm: float) -> FloatArray:
    """Return nodes on the skin and chest wall, one in each cube of the given edge length.

    It is the node closest to the mean of all nodes in the cube.
    """
    level = inverse.model.finest
    on = level.wall_areas > 0
    on[level.contact_nodes.index] = True
    nodes = level.nodes[on]
    cell = ((nodes - nodes.min(axis=0)) // spacing_mm).astype(int)
    _, of = np.unique(cell, axis=0, return_inverse=True)
    of = of.ravel()
    count = np.bincount(of)
    middle = np.column_stack([np.bincount(of, x) / count for x in nodes.T])
    away = np.linalg.norm(nodes - middle[of], axis=1)
    order = np.lexsort((away, of))
    first = np.unique(of[order], return_index=True)[1]
    return np.asarray(nodes[order[first]])


@dataclass(frozen=True, eq=False)
class ScanSensitivity:
    """Sensitivity of the residuals of one scan to one effect.

    Parameters
    ----------
    columns : ndarray or None
        Derivatives of shape (k, q), or (g, k, q) at g places; None for an effect that does not act
        on the scan or could not be simulated.
    idle : bool
        Whether the effect does not act on the scan.
    """

    columns: FloatArray | None
    idle: bool = False


def scan_sensitivity(
    inverse: InverseProblem, at: SolvedFit, number: int, effect: Effect
) -> ScanSensitivity:
    """Differentiate the residuals of one scan with respect to the parameters of one effect.

    Two-sided effects use tangents. The response to one-sided effects is steepest at zero and then
    saturates, so they use secants from neutral. A single parameter uses secants to a small
    magnitude and to a prior standard deviation, treated like places. A localised effect has one
    column, for its size, at each place on a grid.

    Parameters
    ----------
    inverse : InverseProblem
    at : SolvedFit
        Fit of the nominal model.
    number : int
        Index of the scan.
    effect : Effect
    """
    problem = problem_of(inverse.scans[number], at.unknowns, at.z, inverse.frame)
    if not effect.acts_on(problem, inverse.frame):
        return ScanSensitivity(None, idle=True)
    return ScanSensitivity(_columns(inverse, problem, at.predictions[number], effect))


def joined_sensitivity(
    effect: Effect, scans: Sequence[ScanSensitivity]
) -> EffectSensitivity | None:
    """Concatenate the sensitivities of all scans, with zeros where the effect is idle.

    Returns
    -------
    EffectSensitivity or None
        None if the effect acts on no scan, or could not be simulated in one of them.
    """
    acting = [scan.columns for scan in scans if scan.columns is not None]
    if not acting or not all(scan.columns is not None or scan.idle for scan in scans):
        return None
    nothing = np.zeros_like(acting[0])
    stacked = np.concatenate(
        [nothing if scan.columns is None else scan.columns for scan in scans], axis=-2
    )
    sided = np.array([one_sided(p) for p in effect.parameters])
    q = stacked.shape[-1]
    return EffectSensitivity(
        effect.name, effect.family, stacked, np.array(effect.prior_sd[:q]), sided[:q]
    )


def _columns(
    inverse: InverseProblem, problem: Problem, prediction: PredictedScan, effect: Effect
) -> FloatArray | None:
    """Return columns (k, q), or (g, k, q) for several places or magnitudes."""
    if not effect.acts_on_body:
        return observed_columns(inverse, effect, prediction)
    if effect.place is not None:
        return _at_places(inverse, prediction, effect, effect.place)
    if effect.is_one_sided:
        return _secants(inverse, prediction, effect, problem)
    changes = list(effect.changes(problem, inverse.frame))
    return columns_of(inverse, prediction, changes, tolerance=SETTINGS.sensitivities.tangent_error)


def _at_places(
    inverse: InverseProblem, prediction: PredictedScan, effect: Effect, place: Place
) -> FloatArray:
    """Return columns (g, k, q) for q sizes, from one-sided differences of the known forces."""
    without, sizes = prediction.at.problem, range(effect.size_count)
    changes = []
    for offset in places_of(inverse, effect):
        where = dict(zip(place.names, map(float, offset), strict=True))
        for q in sizes:
            step = effect.steps[q]
            there = effect.apply(without, {effect.names[q]: step} | where, inverse.frame)
            changes.append(Change(there, without, step))
    moved = inverse.forward.tangents(prediction.at, changes, SETTINGS.sensitivities.place_error)
    free = spring_stiffness(inverse.model.finest, without)
    columns = []
    for number, (change, u) in enumerate(zip(changes, moved, strict=True)):
        q = number % len(sizes)
        column = prediction.along_normals(u)
        if one_sided(effect.parameters[q]):
            column /= 1 + effect.prior_sd[q] * _yielding(inverse, prediction, change, free, u)
        columns.append(column)
    stacked = np.reshape(columns, (-1, len(sizes), len(prediction.residual)))
    return np.ascontiguousarray(stacked.transpose(0, 2, 1))


def _yielding(
    inverse: InverseProblem,
    prediction: PredictedScan,
    change: Change,
    free: FloatArray,
    moved: FloatArray,
) -> float:
    """Return the relative decrease in displacement due to springs of unit stiffness.

    Springs k D reduce the load by k D u, with u the displacement; u then decreases by a factor of
    1 + k c with c = -u'D du/dk / u'Du, which is exact for a spring at one point of a linear body.
    `free` holds the springs before the change, (n, 3).
    """
    u = prediction.at.solution.displacement_mm
    force = (spring_stiffness(inverse.model.finest, change.plus) - free) / change.step * u
    work = float(np.vdot(force, u))
    return max(0.0, -float(np.vdot(force, moved)) / work) if work > 0 else 0.0


def _secants(
    inverse: InverseProblem, view: PredictedScan, effect: Effect, problem: Problem
) -> FloatArray | None:
    settings = SETTINGS.sensitivities
    problem = inverse.forward.loosened(
        problem, settings.secant_step_mm, settings.secant_friction_steps
    )
    tried = settings.secant_magnitudes if len(effect.names) == 1 else (1.0,)
    places, start = [], view.at
    for share in tried:
        columns = []
        for name, sd in zip(effect.names, effect.prior_sd, strict=True):
            starts = (start,) if start is view.at else (start, view.at)
            simulation = _simulated(inverse, problem, effect, name, share * sd, starts)
            if simulation is None:
                return None
            equilibrium, step = simulation
            if len(effect.names) == 1:
                start = equilibrium
            moved = equilibrium.solution.displacement_mm - view.at.solution.displacement_mm
            columns.append(view.along_normals(moved) / step)
        places.append(np.stack(columns, axis=1))
    return np.stack(places) if len(places) > 1 else places[0]


def _simulated(
    inverse: InverseProblem,
    problem: Problem,
    effect: Effect,
    name: str,
    step: float,
    starts: Sequence[Equilibrium],
) -> tuple[Equilibrium, float] | None:
    """Return an equilibrium with one parameter off neutral, from one of `starts`, and the step.

    If the step cannot be simulated, it is halved, so that an effect is not missed because its
    plausible size is too large for this body. Solving from a larger magnitude may fail even if
    solving from neutral does not.
    """
    for _ in range(1 + SETTINGS.sensitivities.secant_halvings):
        changed = effect.apply(problem, {name: effect.neutral[name] + step}, inverse.frame)
        for start in starts:
            equilibrium: Equilibrium = inverse.forward.equilibrium(inverse.model, changed, start)
            if equilibrium.solution.outcome.converged:
                return equilibrium, step
        step /= 2.0
    return None
