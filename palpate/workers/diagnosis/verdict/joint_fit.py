"""Joint fits of the constants and the parameters of effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis, ScreeningResult, screen
from palpate.workers.diagnosis.fits.effect_sensitivities import starting_places
from palpate.workers.diagnosis.fits.gauss_newton import Fit, SolvedFit, fit
from palpate.workers.diagnosis.linearisation import Linearised
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect, one_sided
from palpate.workers.mechanics.model_parameters import Parameter


@dataclass(frozen=True, eq=False)
class JointFit:
    """A hypothesis with effects at its optimum."""

    effects: tuple[Effect, ...]
    fit: Fit
    log_evidence: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(e.name for e in self.effects)


@dataclass(frozen=True, eq=False)
class SolvedJointFit(JointFit):
    """A joint fit with the equilibria of its scans, from which another fit can start."""

    fit: SolvedFit


def fit_jointly(
    analysis: NominalAnalysis,
    effects: Sequence[Effect],
    each: Each = map,
    base: JointFit | None = None,
) -> JointFit | None:
    """Fit constants and effects, starting localised effects at their best places.

    Parameters
    ----------
    analysis : NominalAnalysis
    effects : sequence of Effect
    each : callable
        Applies a function to every scan; see `workers.diagnosis.fits.gauss_newton.fit`.
    base : JointFit, optional
        A fit of the first effects, from which this fit starts; the other effects start at the
        values expected from screening its residuals. None to start from the nominal fit.

    Returns
    -------
    JointFit or None
        None if neither a starting point nor one closer to neutral could be simulated.
    """
    begun = {} if base is None else base.fit.values()
    linear = analysis.linear if base is None else base.fit.linearised(analysis.inverse)
    new = [effect for effect in effects if effect.names[0] not in begun]
    nominal = analysis.nominal.values() | begun
    starts = _starts(analysis, linear, new)
    few = SETTINGS.joint_fits.trial_iterations if len(starts) > 1 else SETTINGS.fit.max_iterations
    best: SolvedJointFit | None = None
    for start in starts:
        for share in SETTINGS.joint_fits.start_shares:
            there = nominal | _nearer(new, start, share)
            values = _compensated(analysis, linear, new, there)
            fitted = _fitted_from(analysis, effects, values, analysis.nominal, each, few)
            if fitted is not None:
                break
        if fitted is not None and (best is None or fitted.log_evidence > best.log_evidence):
            best = fitted
    if best is None or len(starts) == 1 or best.fit.converged:
        return best
    return _gone_on(analysis, best, each)


def _gone_on(analysis: NominalAnalysis, tried: SolvedJointFit, each: Each) -> SolvedJointFit:
    """Continue a fit that was stopped after a few iterations until it ends."""
    values, near = tried.fit.values(), tried.fit
    found = _fitted_from(analysis, tried.effects, values, near, each)
    if found is None:
        return tried
    iterations = near.iterations + found.fit.iterations
    return replace(found, fit=replace(found.fit, iterations=iterations))


def _fitted_from(
    analysis: NominalAnalysis,
    effects: Sequence[Effect],
    values: Mapping[str, float],
    near: SolvedFit,
    each: Each,
    max_iterations: int = SETTINGS.fit.max_iterations,
) -> SolvedJointFit | None:
    """Fit from given parameter values, starting from the equilibria of a nearby fit."""
    inverse = analysis.inverse
    free = unknowns(inverse.free, effects)
    z = np.array([values[name] for name in free.names])
    k = len(inverse.free)
    z[:k] = np.log(z[:k])
    fitted = fit(inverse, free, z, near.starts(), near.poses(), each, max_iterations)
    if fitted is None:
        return None
    return SolvedJointFit(tuple(effects), fitted, fitted.log_evidence(inverse))


def _compensated(
    analysis: NominalAnalysis,
    at: Linearised,
    effects: Sequence[Effect],
    values: Mapping[str, float],
) -> dict[str, float]:
    """Return the values with the constants adjusted to offset most of the effects."""
    sensitivities, free = analysis.sensitivity_by_name, analysis.inverse.free
    k = len(free)
    moved = np.zeros(at.size)
    for effect in effects:
        if effect.place is None:
            away = [values[name] - effect.neutral[name] for name in effect.names]
            moved += sensitivities[effect.name].places[0] @ np.array(away)
    A = at.scaled_nominal[:, :k]
    step = np.linalg.solve(np.eye(k) + A.T @ A, A.T @ at.whiten(moved))
    most = SETTINGS.joint_fits.most_compensation
    change = -np.clip(step, -most, most) * at.nominal_sd[:k]
    taken = {f.name: values[f.name] * float(np.exp(c)) for f, c in zip(free, change, strict=True)}
    return dict(values) | taken


def _starts(
    analysis: NominalAnalysis, at: Linearised, effects: Sequence[Effect]
) -> list[dict[str, float]]:
    """Return the starting parameters of the effects: several starts if one effect has places.

    If two effects have places, each starts only at its best place. The expected sizes come from a
    screening of the residuals of `at`.
    """
    screened = {
        effect.name: analysis.screening_by_name[effect.name]
        if at is analysis.linear
        else screen(at, [analysis.sensitivity_by_name[effect.name]])[0]
        for effect in effects
    }
    common: dict[str, float] = {}
    for effect in effects:
        if effect.place is None:
            steep = analysis.is_steep(effect)
            common |= _expected(effect, screened[effect.name].estimate, steep=steep)
    placed = [effect for effect in effects if effect.place is not None]
    starts = [common]
    for effect in placed:
        there = _placed(analysis, effect, screened[effect.name])
        tried = there if len(placed) == 1 else there[:1]
        starts = [start | place for start in starts for place in tried]
    return starts


def _placed(
    analysis: NominalAnalysis, effect: Effect, screened: ScreeningResult
) -> list[dict[str, float]]:
    """Return the starting parameters of an effect at each of its best places."""
    if effect.place is None:
        raise ValueError(f"{effect.name} acts everywhere")
    places = analysis.places(effect)
    sized = zip(effect.parameters, effect.prior_sd, screened.estimate, strict=False)
    begun = effect.neutral | {p.name: _begin_at_place(p, sd, float(v)) for p, sd, v in sized}
    best = starting_places(effect, places, screened.place_log_bayes_factors)
    names = effect.place.names
    return [begun | dict(zip(names, map(float, places[i]), strict=True)) for i in best]


def _nearer(
    effects: Sequence[Effect], start: Mapping[str, float], share: float
) -> dict[str, float]:
    """Return the parameters with their sizes closer to neutral and their places unchanged."""
    places = {name for e in effects if e.place is not None for name in e.place.names}
    neutral = {name: value for e in effects for name, value in e.neutral.items()}
    return {
        name: value if name in places else neutral[name] + share * (value - neutral[name])
        for name, value in start.items()
    }


def _expected(effect: Effect, estimate: FloatArray, *, steep: bool) -> dict[str, float]:
    if effect.if_present:
        return {n: mean for n, (mean, _) in zip(effect.names, effect.if_present, strict=True)}
    each = zip(effect.parameters, effect.prior_sd, estimate, strict=True)
    return {p.name: _begin(p, sd, float(value), steep=steep) for p, sd, value in each}


def _begin(parameter: Parameter, sd: float, expected: float, *, steep: bool = False) -> float:
    """Return the starting value of a parameter, given the change expected from screening.

    The response to a `steep` parameter grows faster than its magnitude and is so small near zero
    that a fit would stay there; it therefore starts at a minimum distance from zero.
    """
    settings, neutral = SETTINGS.joint_fits, parameter.neutral or 0.0
    most = settings.most_start * sd
    if one_sided(parameter):
        least = (settings.steep_start if steep else settings.least_start) * sd
        return neutral + float(np.clip(expected, least, most))
    return neutral + float(np.clip(settings.start * expected, -most, most))


def _begin_at_place(parameter: Parameter, sd: float, expected: float) -> float:
    """Return the starting size of a localised effect, not neutral, so that its place matters."""
    settings = SETTINGS.joint_fits
    if one_sided(parameter):
        return _begin(parameter, sd, expected)
    most = settings.most_place_start * sd
    return float(np.clip(settings.start * expected, -most, most)) or settings.least_place_start * sd
