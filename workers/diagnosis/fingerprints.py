"""What every effect of a catalogue would do to the residuals of the nominal fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from storage.values import FloatArray
from workers.diagnosis.fingerprint import Fingerprint
from workers.diagnosis.fit import Fit
from workers.diagnosis.subject import Scan, Subject
from workers.diagnosis.views import View, columns_of, observed_columns, problem_of
from workers.effects.base import Effect, one_sided
from workers.effects.inclusion import INCLUSION, PLACE, RATIO
from workers.fem.problem import Problem
from workers.fem.solve import equilibrium

# Centres at which a lump is looked for.
GRID_MM = 12.0
# How deep inside the body they lie at least.
DEPTH_MM = 6.0
# Magnitudes at which a one-sided effect is tried, in prior standard deviations.
TRIED = (1.0, 0.25)
# Columns only choose what is refitted: relative error of a tangent, Newton's last step of a
# secant in mm.
ROUGH = 1e-4
ROUGH_MM = 0.02


@dataclass(frozen=True, eq=False)
class Places:
    """Where a lump was looked for: offsets from the middle of the body, (g, 3) in mm."""

    offsets: FloatArray


def fingerprints(
    subject: Subject, at: Fit, effects: Sequence[Effect]
) -> tuple[list[Fingerprint], Places]:
    """Columns of every effect that acts on the subject.

    Two-sided effects are tangents. One-sided ones, which set in with full force and
    then tire, are secants from neutral; their tangents at zero would mislead. One with a
    single parameter gets a secant to a small magnitude and one to a prior standard
    deviation, as if they were places. A lump gets a column for each place of a grid.

    Returns
    -------
    list of Fingerprint
        One that cannot be simulated is left out.
    Places
    """
    places = grid(subject)
    acting = [e for e in effects if acts(subject, at, e)]
    columns: dict[str, list[FloatArray]] = {e.name: [] for e in acting}
    for scan, view in zip(subject.scans, at.views, strict=True):
        for effect in acting:
            found = _columns(subject, scan, at, view, effect, places)
            if found is not None:
                columns[effect.name].append(found)
    whole = [e for e in acting if len(columns[e.name]) == len(subject.scans)]
    return [_fingerprint(e, columns[e.name]) for e in whole], places


def grid(subject: Subject) -> Places:
    """Centres inside the body, `GRID_MM` apart."""
    nodes = subject.model.finest.nodes
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    axes = [np.arange(a + GRID_MM / 2, b, GRID_MM) for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    outline = subject.points.interface == 0
    away = np.linalg.norm(centres[:, None] - subject.points.points[outline][None], axis=2).min(
        axis=1
    )
    near = np.linalg.norm(centres[:, None] - nodes[None], axis=2).min(axis=1)
    inside = (away > DEPTH_MM) & (near < GRID_MM / 2)
    return Places(centres[inside] - np.asarray(subject.frame.centre_mm))


def acts(subject: Subject, at: Fit, effect: Effect) -> bool:
    """Whether an effect changes any scan of the subject."""
    return any(
        effect.acts_on(problem_of(scan, at.unknowns, at.z, subject.frame), subject.frame)
        for scan in subject.scans
    )


def _columns(
    subject: Subject, scan: Scan, at: Fit, view: View, effect: Effect, places: Places
) -> FloatArray | None:
    """Shape (k, q), or (g, k, 1) for a lump and for what is tried at several magnitudes."""
    if effect.observation is not None:
        return observed_columns(subject, effect, view)
    problem = problem_of(scan, at.unknowns, at.z, subject.frame)
    if effect is INCLUSION:
        changes = []
        for offset in places.offsets:
            where = {RATIO: 0.0} | dict(zip(PLACE, map(float, offset), strict=True))
            changes.append(effect.changes(problem, subject.frame, where)[0])
        return columns_of(subject, view, changes, tolerance=ROUGH).T[:, :, None]
    if any(one_sided(p) for p in effect.parameters):
        return _secants(subject, view, effect, problem)
    return columns_of(subject, view, effect.changes(problem, subject.frame), tolerance=ROUGH)


def _secants(subject: Subject, view: View, effect: Effect, problem: Problem) -> FloatArray | None:
    problem = replace(problem, tolerance_mm=max(problem.tolerance_mm, ROUGH_MM))
    tried = TRIED if len(effect.names) == 1 else (1.0,)
    places, start = [], view.at
    for share in tried:
        columns = []
        for name, sd in zip(effect.names, effect.prior_sd, strict=True):
            step = share * sd
            changed = effect.apply(problem, {name: effect.neutral[name] + step}, subject.frame)
            found = equilibrium(subject.model, changed, start)
            if not found.solution.outcome.converged:
                return None
            if len(effect.names) == 1:
                start = found
            moved = found.solution.displacement_mm - view.at.solution.displacement_mm
            columns.append(((subject.at_points @ moved) * view.normals).sum(axis=1) / step)
        places.append(np.stack(columns, axis=1))
    return np.stack(places) if len(places) > 1 else places[0]


def _fingerprint(effect: Effect, columns: Sequence[FloatArray]) -> Fingerprint:
    stacked = np.concatenate(columns, axis=-2)
    sided = np.array([one_sided(p) for p in effect.parameters])
    if effect is INCLUSION:
        sided = np.zeros(1, np.bool_)
    q = stacked.shape[-1]
    return Fingerprint(
        effect.name, effect.family, stacked, np.array(effect.prior_sd[:q]), sided[:q]
    )
