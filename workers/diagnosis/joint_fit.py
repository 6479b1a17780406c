"""The constants and the parameters of some effects, fitted again together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.diagnosis.evidence import log_evidence
from workers.diagnosis.gauss_newton import Fit, fit
from workers.diagnosis.inverse_problem import unknowns
from workers.diagnosis.nominal_analysis import NominalAnalysis
from workers.diagnosis.settings import SETTINGS
from workers.mechanics.effects.base import Effect, one_sided
from workers.mechanics.effects.inclusion import INCLUSION, PLACE, RATIO
from workers.scan_threads import Each


@dataclass(frozen=True, eq=False)
class JointFit:
    """A hypothesis with effects at its optimum."""

    effects: tuple[Effect, ...]
    fit: Fit
    log_evidence: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(e.name for e in self.effects)


def fit_jointly(
    analysis: NominalAnalysis, effects: Sequence[Effect], each: Each = map
) -> JointFit | None:
    """Fit constants and effects, from the best places where an effect has one.

    Parameters
    ----------
    analysis : NominalAnalysis
        Whose screening says where the fit begins.
    effects : sequence of Effect
    each : callable
        Calls a function with every scan; see `workers.diagnosis.gauss_newton.fit`.

    Returns
    -------
    JointFit or None
        None if no start could be simulated.
    """
    best: JointFit | None = None
    for start in _starts(analysis, effects):
        fitted = _fitted_from(analysis, effects, start, each)
        if fitted is not None and (best is None or fitted.log_evidence > best.log_evidence):
            best = fitted
    return best


def _fitted_from(
    analysis: NominalAnalysis, effects: Sequence[Effect], start: Mapping[str, float], each: Each
) -> JointFit | None:
    inverse, nominal = analysis.inverse, analysis.nominal
    free = unknowns(inverse.free, effects)
    known = nominal.values() | dict(start)
    z = np.array([known[name] for name in free.names])
    k = len(inverse.free)
    z[:k] = np.log(z[:k])
    z[:k] += _compensation(analysis, _new(analysis, effects), start)
    fitted = fit(inverse, free, z, nominal.starts(), nominal.poses(), each)
    if fitted is None:
        return None
    poses = np.zeros(inverse.nuisance_count, np.bool_)
    evidence = log_evidence(fitted.linearised_with_poses(inverse), np.append(free.one_sided, poses))
    return JointFit(tuple(effects), fitted, evidence)


def _compensation(
    analysis: NominalAnalysis, effects: Sequence[Effect], start: Mapping[str, float]
) -> FloatArray:
    """Return the change of the constants' logarithms that takes up most of what effects do."""
    at, sensitivities = analysis.linear, analysis.sensitivity_by_name
    k = len(analysis.inverse.free)
    moved = np.zeros(at.size)
    for effect in effects:
        columns = sensitivities[effect.name].places[0]
        if effect is INCLUSION or columns.shape[1] != len(effect.names):
            continue
        away = [start[name] - effect.neutral[name] for name in effect.names]
        moved += columns @ np.array(away)
    A = at.scaled_nominal[:, :k]
    step = np.linalg.solve(np.eye(k) + A.T @ A, A.T @ at.whiten(moved))
    most = SETTINGS.joint_fits.most_compensation
    return np.asarray(-np.clip(step, -most, most) * at.nominal_sd[:k])


def _starts(analysis: NominalAnalysis, effects: Sequence[Effect]) -> list[dict[str, float]]:
    """Return the parameters of the effects to begin with: several where a lump has places."""
    screening, new = analysis.screening_by_name, _new(analysis, effects)
    common: dict[str, float] = {}
    if len(new) < len(effects):
        common |= analysis.begun[effects[0].name]
    for effect in new:
        if effect is not INCLUSION:
            common |= _expected(effect, screening[effect.name].estimate)
    if INCLUSION not in new:
        return [common]
    screened, settings = screening[INCLUSION.name], SETTINGS.joint_fits
    ranked = np.argsort(-screened.place_log_bayes_factors)[: settings.inclusion_starts]
    starts = []
    for place in ranked:
        offset = map(float, analysis.inclusion_grid.offsets[place])
        expected = settings.start * screened.estimate[0]
        ratio = float(
            np.clip(expected, -settings.most_start_log_ratio, settings.most_start_log_ratio)
        )
        ratio = ratio or settings.least_start_log_ratio
        starts.append(
            common | INCLUSION.neutral | dict(zip(PLACE, offset, strict=True)) | {RATIO: ratio}
        )
    return starts


def _new(analysis: NominalAnalysis, effects: Sequence[Effect]) -> Sequence[Effect]:
    """Return the effects less the first one if that was fitted before."""
    return effects[1:] if effects[0].name in analysis.begun else effects


def _expected(effect: Effect, estimate: FloatArray) -> dict[str, float]:
    if effect.if_present:
        return {n: mean for n, (mean, _) in zip(effect.names, effect.if_present, strict=True)}
    start, settings = {}, SETTINGS.joint_fits
    for p, sd, value in zip(effect.parameters, effect.prior_sd, estimate, strict=True):
        neutral, most = effect.neutral[p.name], settings.most_start * sd
        if one_sided(p):
            start[p.name] = neutral + float(np.clip(value, settings.least_start * sd, most))
        else:
            start[p.name] = neutral + float(np.clip(settings.start * value, -most, most))
    return start
