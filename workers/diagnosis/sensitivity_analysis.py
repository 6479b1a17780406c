"""What every effect of a catalogue would do to the residuals of the nominal fit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.diagnosis.effect_sensitivity import EffectSensitivity
from workers.diagnosis.gauss_newton import SolvedFit
from workers.diagnosis.inverse_problem import InverseProblem
from workers.diagnosis.scan_prediction import (
    PredictedScan,
    columns_of,
    observed_columns,
    problem_of,
)
from workers.diagnosis.settings import SETTINGS
from workers.mechanics.effects.base import Effect, one_sided
from workers.mechanics.effects.inclusion import INCLUSION, PLACE, RATIO
from workers.mechanics.fem.problem import Problem
from workers.mechanics.fem.sensitivity import Change
from workers.mechanics.fem.solve import Equilibrium


@dataclass(frozen=True, eq=False)
class InclusionGrid:
    """Where a lump was looked for: offsets from the middle of the body, (g, 3) in mm."""

    offsets: FloatArray


@dataclass(frozen=True, eq=False)
class ScanSensitivity:
    """What one effect would do to the residuals of one scan.

    Parameters
    ----------
    columns : ndarray or None
        Shape (k, q), or (g, k, q) at g places; None for an effect that does nothing there, or
        that could not be simulated.
    idle : bool
        Whether it does nothing there.
    """

    columns: FloatArray | None
    idle: bool = False


def scan_sensitivity(
    inverse: InverseProblem, at: SolvedFit, number: int, effect: Effect
) -> ScanSensitivity:
    """Differentiate the residuals of one scan by the parameters of one effect.

    Two-sided effects are tangents. One-sided ones, which set in with full force and
    then tire, are secants from neutral; their tangents at zero would mislead. One with a
    single parameter gets a secant to a small magnitude and one to a prior standard
    deviation, as if they were places. A lump gets a column for each place of a grid.

    Parameters
    ----------
    inverse : InverseProblem
    at : SolvedFit
        Of the nominal model.
    number : int
        Of the scan.
    effect : Effect
    """
    problem = problem_of(inverse.scans[number], at.unknowns, at.z, inverse.frame)
    if not effect.acts_on(problem, inverse.frame):
        return ScanSensitivity(None, idle=True)
    return ScanSensitivity(_columns(inverse, problem, at.predictions[number], effect))


def joined_sensitivity(
    effect: Effect, scans: Sequence[ScanSensitivity]
) -> EffectSensitivity | None:
    """Join what an effect does to all scans, one after another; zero where it is idle.

    Returns
    -------
    EffectSensitivity or None
        None if it does nothing in any scan, or could not be simulated in some.
    """
    acting = [one.columns for one in scans if one.columns is not None]
    if not acting or not all(one.columns is not None or one.idle for one in scans):
        return None
    nothing = np.zeros_like(acting[0])
    stacked = np.concatenate(
        [nothing if one.columns is None else one.columns for one in scans], axis=-2
    )
    sided = np.array([one_sided(p) for p in effect.parameters])
    if effect is INCLUSION:
        sided = np.zeros(1, np.bool_)
    q = stacked.shape[-1]
    return EffectSensitivity(
        effect.name, effect.family, stacked, np.array(effect.prior_sd[:q]), sided[:q]
    )


def inclusion_grid(inverse: InverseProblem) -> InclusionGrid:
    """Return centres inside the body, `inclusion_grid_mm` of the settings apart."""
    nodes = inverse.model.finest.nodes
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    axes = [
        np.arange(
            a + SETTINGS.sensitivities.inclusion_grid_mm / 2,
            b,
            SETTINGS.sensitivities.inclusion_grid_mm,
        )
        for a, b in zip(low, high, strict=True)
    ]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    outline = inverse.points.points[inverse.points.interface == 0]
    away = np.linalg.norm(centres[:, None] - outline[None], axis=2).min(axis=1)
    near = np.linalg.norm(centres[:, None] - nodes[None], axis=2).min(axis=1)
    inside = (away > SETTINGS.sensitivities.inclusion_depth_mm) & (
        near < SETTINGS.sensitivities.inclusion_grid_mm / 2
    )
    return InclusionGrid(centres[inside] - np.asarray(inverse.frame.centre_mm))


def _columns(
    inverse: InverseProblem, problem: Problem, prediction: PredictedScan, effect: Effect
) -> FloatArray | None:
    """Return (k, q), or (g, k, 1) for a lump and for what is tried at several magnitudes."""
    if effect.observation is not None:
        return observed_columns(inverse, effect, prediction)
    if effect is INCLUSION:
        changes = [_lump(inverse, prediction, offset) for offset in inclusion_grid(inverse).offsets]
        return columns_of(
            inverse, prediction, changes, tolerance=SETTINGS.sensitivities.tangent_error
        ).T[:, :, None]
    if any(one_sided(p) for p in effect.parameters):
        return _secants(inverse, prediction, effect, problem)
    changes = list(effect.changes(problem, inverse.frame))
    return columns_of(inverse, prediction, changes, tolerance=SETTINGS.sensitivities.tangent_error)


def _lump(inverse: InverseProblem, prediction: PredictedScan, offset: FloatArray) -> Change:
    """Return what a lump changes; one-sided, for the forces without it are those at hand."""
    step, without = INCLUSION.steps[0], prediction.at.problem
    where = dict(zip(PLACE, map(float, offset), strict=True))
    return Change(INCLUSION.apply(without, {RATIO: step} | where, inverse.frame), without, step)


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
            found = _simulated(inverse, problem, effect, name, share * sd, start)
            if found is None:
                return None
            at, step = found
            if len(effect.names) == 1:
                start = at
            moved = at.solution.displacement_mm - view.at.solution.displacement_mm
            columns.append(((inverse.at_points @ moved) * view.normals).sum(axis=1) / step)
        places.append(np.stack(columns, axis=1))
    return np.stack(places) if len(places) > 1 else places[0]


def _simulated(
    inverse: InverseProblem,
    problem: Problem,
    effect: Effect,
    name: str,
    step: float,
    start: Equilibrium,
) -> tuple[Equilibrium, float] | None:
    """Return the body with one parameter away from neutral, and how far.

    Where that cannot be simulated, half as far is tried: an effect must not go unheard because
    its plausible size is too much for this body.
    """
    for _ in range(1 + SETTINGS.sensitivities.secant_halvings):
        changed = effect.apply(problem, {name: effect.neutral[name] + step}, inverse.frame)
        found: Equilibrium = inverse.forward.equilibrium(inverse.model, changed, start)
        if found.solution.outcome.converged:
            return found, step
        step /= 2.0
    return None
