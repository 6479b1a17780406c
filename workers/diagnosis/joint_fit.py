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
from workers.mechanics.parameters import Parameter
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
        if effect.place is None:
            away = [start[name] - effect.neutral[name] for name in effect.names]
            moved += sensitivities[effect.name].places[0] @ np.array(away)
    A = at.scaled_nominal[:, :k]
    step = np.linalg.solve(np.eye(k) + A.T @ A, A.T @ at.whiten(moved))
    most = SETTINGS.joint_fits.most_compensation
    return np.asarray(-np.clip(step, -most, most) * at.nominal_sd[:k])


def _starts(analysis: NominalAnalysis, effects: Sequence[Effect]) -> list[dict[str, float]]:
    """Return the parameters of the effects to begin with: several if one of them has places.

    Where two have, each begins at its best place alone.
    """
    screening, new = analysis.screening_by_name, _new(analysis, effects)
    common: dict[str, float] = {}
    if len(new) < len(effects):
        common |= analysis.begun[effects[0].name]
    placed = [effect for effect in new if effect.place is not None]
    for effect in new:
        if effect.place is None:
            common |= _expected(effect, screening[effect.name].estimate)
    starts = [common]
    for effect in placed:
        at = _placed(analysis, effect, several=len(placed) == 1)
        starts = [start | one for start in starts for one in at]
    return starts


def _placed(analysis: NominalAnalysis, effect: Effect, several: bool) -> list[dict[str, float]]:
    """Return the parameters of an effect at its best place, or at several of the best."""
    if effect.place is None:
        raise ValueError(f"{effect.name} acts everywhere")
    screened, places = analysis.screening_by_name[effect.name], analysis.places(effect)
    count = SETTINGS.joint_fits.place_starts if several else 1
    best = np.argsort(-screened.place_log_bayes_factors, kind="stable")[:count]
    sized = zip(effect.parameters, effect.prior_sd, screened.estimate, strict=False)
    begun = effect.neutral | {p.name: _begin_at_place(p, sd, float(v)) for p, sd, v in sized}
    names = effect.place.names
    return [begun | dict(zip(names, map(float, places[i]), strict=True)) for i in best]


def _new(analysis: NominalAnalysis, effects: Sequence[Effect]) -> Sequence[Effect]:
    """Return the effects less the first one if that was fitted before."""
    return effects[1:] if effects[0].name in analysis.begun else effects


def _expected(effect: Effect, estimate: FloatArray) -> dict[str, float]:
    if effect.if_present:
        return {n: mean for n, (mean, _) in zip(effect.names, effect.if_present, strict=True)}
    each = zip(effect.parameters, effect.prior_sd, estimate, strict=True)
    return {p.name: _begin(p, sd, float(value)) for p, sd, value in each}


def _begin(parameter: Parameter, sd: float, expected: float) -> float:
    """Return where the fit of a parameter begins, of which the screening expects a change."""
    settings, neutral = SETTINGS.joint_fits, parameter.neutral or 0.0
    most = settings.most_start * sd
    if one_sided(parameter):
        return neutral + float(np.clip(expected, settings.least_start * sd, most))
    return neutral + float(np.clip(settings.start * expected, -most, most))


def _begin_at_place(parameter: Parameter, sd: float, expected: float) -> float:
    """Return the same for a size at one place: never neutral, for there the place does nothing."""
    settings = SETTINGS.joint_fits
    if one_sided(parameter):
        return _begin(parameter, sd, expected)
    most = settings.most_place_start * sd
    return float(np.clip(settings.start * expected, -most, most)) or settings.least_place_start * sd
