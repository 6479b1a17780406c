"""Summary of a diagnosis in plain numbers; `diagnosis_summary` has the schema."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import minimum_detectable
from palpate.workers.diagnosis.fits.gauss_newton import Fit
from palpate.workers.diagnosis.fits.nominal_calibration import distances_mm
from palpate.workers.diagnosis.linearisation import LinearFit, Linearised, Registration
from palpate.workers.diagnosis.outcome.diagnosis_summary import (
    ConstantEstimate,
    EffectSummary,
    GapEstimate,
    GapShrinkage,
    GapSummary,
    InterfaceNoise,
    JointFitSummary,
    ParameterEstimate,
    RegionGap,
    ShareEstimate,
    Summary,
)
from palpate.workers.diagnosis.outcome.gap_and_shrinkage import (
    Comparison,
    Gap,
    Shrinkage,
    gap,
    region_gap,
)
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant, InverseProblem
from palpate.workers.diagnosis.problem.planned_acquisition import INTERFACES
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis, thresholds
from palpate.workers.mechanics.effects.effect import Effect, one_sided
from palpate.workers.mechanics.model_parameters import KPA, Parameter, shown, shown_change

# Number of standard deviations on either side of the mean that contain 90 % of a normal
# distribution.
DEVIATIONS_90 = 1.6449
# Sizes beyond so many prior standard deviations are no longer linear, and not plausible.
MOST_DEVIATIONS = 3.0
# Scans with which the others, without one that is judged, can still choose causes.
FEWEST_TO_CHOOSE = 3


def summarise(diagnosis: Diagnosis, effects: Sequence[Effect], case: str) -> Summary:
    """Summarise a diagnosis in plain numbers.

    Parameters
    ----------
    diagnosis : Diagnosis
    effects : sequence of Effect
        The catalogue.
    case : str
        Name of the case.
    """
    reached, analysis = diagnosis.verdict, diagnosis.analysis
    acting, registered = analysis.sensitivity_by_name, _registered(diagnosis)
    return Summary(
        case=case,
        verdict=reached.kind,
        primary=reached.primary,
        effects=tuple(_effect(diagnosis, e) for e in effects if e.name in acting),
        rivals=reached.rivals,
        absorbed=reached.hidden,
        gain=reached.gain,
        left_gain=reached.left_gain,
        something_else=reached.something_else_acts,
        gap_mm=_gap_mm(diagnosis, registered),
        where=tuple(_where(diagnosis.analysis.inverse, registered)),
        constants=_constants(diagnosis),
        refits=tuple(_joint_fit(diagnosis, names) for names in diagnosis.joint_fits),
        points=len(analysis.inverse.points),
        left_out=analysis.inverse.left_out,
        noise=_noise(analysis.inverse),
    )


def _noise(inverse: InverseProblem) -> tuple[InterfaceNoise, ...] | None:
    """Return the segmentation noise of each interface; None if the noise was measured."""
    if inverse.learnt is None or not inverse.is_segmented:
        return None
    stated = inverse.noise.sd_mm
    return tuple(
        InterfaceNoise(interface.name, stated, float(stated * scale))
        for interface, scale in zip(INTERFACES, inverse.learnt.scales, strict=False)
    )


def _effect(diagnosis: Diagnosis, effect: Effect) -> EffectSummary:
    screened = diagnosis.analysis.screening_by_name[effect.name]
    best = diagnosis.best
    names = best.names if best is not None and effect.name in best.names else (effect.name,)
    parameters = _parameters(diagnosis, effect, names)
    lead = max(parameters[: effect.size_count], key=_in_deviations)
    seen_from, seen_unit = _seen_from(diagnosis, effect, parameters.index(lead))
    return EffectSummary(
        name=effect.name,
        family=effect.family,
        summary=effect.summary,
        gain=diagnosis.gain((effect.name,)) if (effect.name,) in diagnosis.joint_fits else None,
        magnitude=lead.magnitude,
        sd=lead.sd,
        unit=lead.unit,
        parameters=tuple(parameters),
        log_bayes_factor=screened.log_bayes_factor,
        absorbed_share=screened.absorbed,
        refitted=names in diagnosis.joint_fits,
        shown=lead.shown,
        seen_from=seen_from,
        seen_unit=seen_unit,
    )


def _seen_from(diagnosis: Diagnosis, effect: Effect, number: int) -> tuple[float | None, str]:
    """Return the change of a parameter that these data would have shown, and its unit.

    It is the one whose expected gain reaches the threshold of a first cause; None if no plausible
    size does.
    """
    analysis, parameter = diagnosis.analysis, effect.parameters[number]
    if effect.name in diagnosis.verdict.hidden:
        return None, ""
    sensitivity = analysis.sensitivity_by_name[effect.name]
    strength = 2.0 * thresholds(analysis.inverse).first
    size = float(minimum_detectable(analysis.linear, sensitivity, strength)[number])
    if not size < MOST_DEVIATIONS * effect.prior_sd[number]:
        return None, ""
    at_door = parameter.unit.to_door(size)
    return shown_change(parameter.reading, at_door, parameter.unit.symbol)


def _parameters(
    diagnosis: Diagnosis, effect: Effect, names: tuple[str, ...]
) -> list[ParameterEstimate]:
    """Return the parameters from the joint fit of `names`, or else from the screening.

    Positions are in the coordinates of the scans.
    """
    analysis, fitted = diagnosis.analysis, diagnosis.joint_fits.get(names)
    spread = None if fitted is None else _parameter_sd(analysis.inverse, fitted.fit)
    screened = analysis.screening_by_name[effect.name]
    centre_mm = analysis.inverse.frame.centre_mm
    positions = {} if effect.place is None else effect.place.positions_mm(centre_mm)
    needs_nu = any(p.reading.kind == "poisson" for p in effect.parameters)
    nu = _poissons_ratio(diagnosis) if needs_nu else None
    estimates = []
    for i, parameter in enumerate(effect.parameters):
        if fitted is not None and spread is not None:
            index = fitted.fit.unknowns.names.index(parameter.name)
            value, sd = float(fitted.fit.z[index]), float(spread[index])
            if i < effect.size_count:
                of_form = SETTINGS.gap.form_sd * (value - effect.neutral[parameter.name])
                sd = float(np.hypot(sd, of_form if analysis.inverse.is_segmented else 0.0))
        elif i < len(screened.estimate):
            value, sd = float(screened.estimate[i]), float(screened.estimate_sd[i])
            if one_sided(parameter):
                value = max(value, effect.neutral[parameter.name])
        else:
            continue
        name, origin = positions.get(parameter.name, (parameter.door_name, 0.0))
        is_size = i < effect.size_count
        estimate = _estimate_of(parameter, origin + value, sd, nu, is_size=is_size)
        estimates.append(replace(estimate, parameter=name))
    return estimates


def _estimate_of(
    parameter: Parameter, value: float, sd: float, nu: float | None, *, is_size: bool
) -> ParameterEstimate:
    """Return a parameter in external units; the location of an effect has no neutral value."""
    unit = parameter.unit
    at_door, spread = unit.to_door(value), unit.to_door(sd)
    neutral = unit.to_door(parameter.neutral or 0.0)
    least = neutral if one_sided(parameter) else -math.inf
    read = shown(parameter.reading, at_door, spread, neutral, unit.symbol, nu, least)
    if not is_size:
        read = replace(read, neutral=None)
    return ParameterEstimate(parameter.door_name, at_door, spread, unit.symbol, read)


def _poissons_ratio(diagnosis: Diagnosis) -> float | None:
    """Return the nominal nu; None if tissues differ or the problem has none."""
    analysis = diagnosis.analysis
    problem = analysis.inverse.scans[0].problem(analysis.nominal.values())
    tissues = getattr(problem, "constants", {}).values()
    found = {constants.poisson for constants in tissues}
    return found.pop() if len(found) == 1 else None


def _in_deviations(parameter: ParameterEstimate) -> float:
    return abs(float(parameter.magnitude)) / max(float(parameter.sd), 1e-12)


def _gap_mm(diagnosis: Diagnosis, registered: LinearFit) -> GapSummary:
    analysis, best = diagnosis.analysis, diagnosis.best
    inverse = analysis.inverse
    place, floor_mm = inverse.is_place, _floor_mm(inverse, analysis.linear)
    whole = gap(registered, place, floor_mm)
    fitted_mm, undeformed_mm = distances_mm(inverse, analysis.nominal if best is None else best.fit)
    alone = GapSummary(
        _estimate(whole),
        whole.noise_mm,
        floor_mm,
        None,
        None,
        None,
        fitted_mm=fitted_mm,
        undeformed_mm=undeformed_mm,
    )
    if best is None:
        return alone
    comparison = Comparison(
        analysis.linear_with_poses,
        best.fit.linearised_with_poses(inverse),
        SETTINGS.gap.seed,
        floor_mm=floor_mm,
        registered=inverse.nuisance_count,
        judged=place,
    )
    found = _compared(comparison.shrinkage())
    inside = replace(alone, before=found.before, after=found.after, share=found.share)
    return _with_held_out(inside, diagnosis, comparison)


def _registered(diagnosis: Diagnosis) -> LinearFit:
    """Return the nominal fit with the scan poses that follow from the most probable cause.

    An unlisted cause is represented by a smooth field; otherwise a tilted plate would be mistaken
    for a rotated scan.
    """
    analysis = diagnosis.analysis
    inverse, nominal = analysis.inverse, analysis.linear_with_poses
    poses = inverse.nuisance_count
    if not poses or diagnosis.verdict.kind == "no-gap":
        return LinearFit(nominal)
    best = diagnosis.best
    if best is not None:
        causes = best.fit.linearised_with_poses(inverse)
    else:
        field = analysis.field
        causes = Linearised(
            nominal.residual,
            np.hstack([field, nominal.nominal]),
            np.append(np.ones(field.shape[1]), nominal.nominal_sd),
            np.append(np.zeros(field.shape[1]), nominal.nominal_offset),
            nominal.covariance_factor,
        )
    where = Registration.by(LinearFit(causes), poses, nominal.residual)
    return LinearFit(nominal, registration=where)


def _with_held_out(inside: GapSummary, diagnosis: Diagnosis, comparison: Comparison) -> GapSummary:
    """Add the gap of each scan under a fit to the others, which also choose the effects."""
    inverse = diagnosis.analysis.inverse
    scans = [scan.name for scan in inverse.scans]
    if len(scans) < 2:
        return replace(inside, held_out="one scan only")
    how, chosen = "each scan judged by a fit to the others", None
    if len(scans) >= FEWEST_TO_CHOOSE:
        how = "each scan judged by a fit to the others, which also choose the causes"
        named = set(diagnosis.verdict.primary)
        rows = [inverse.rows != number for number in range(len(scans))]
        chosen = [set(diagnosis.chosen_on(others)) == named for others in rows]
        again = tuple(name for name, is_same in zip(scans, chosen, strict=True) if is_same)
        inside = replace(inside, chosen_again=again)
    whole, parts = comparison.unseen(inverse.rows, chosen)
    by_name = dict(zip(scans, parts, strict=True))
    inside = replace(inside, not_judged=tuple(n for n, part in by_name.items() if part is None))
    if whole is None:
        return replace(inside, held_out="no scan is held by a fit to the others")
    judged = _compared(whole)
    return replace(
        inside,
        held_out_before=judged.before,
        held_out_after=judged.after,
        held_out_share=judged.share,
        held_out=how,
        held_out_each={n: _compared(part) for n, part in by_name.items() if part is not None},
    )


def _floor_mm(inverse: InverseProblem, nominal: Linearised) -> float:
    """Return the error that even the true model has; without it, gaps near zero would be too small.

    It combines the fitted noise, the remaining mesh error (taken equal to the correction by a finer
    mesh), the segmentation error of the meshed body, and a factor for unknown contributions.
    """
    fitted = LinearFit(nominal, judge=inverse.is_place)
    whole = np.hypot(fitted.floor_mm, _meshed_mm(inverse))
    return SETTINGS.gap.floor_factor * float(whole)


def _meshed_mm(inverse: InverseProblem) -> float:
    """Return the known error common to all models, due to mesh and segmentation of the body."""
    mesh = np.sqrt((inverse.bias[inverse.is_place] ** 2).mean())
    drawn = SETTINGS.gap.drawn_noises * inverse.noise.reference_sd_mm
    return float(np.hypot(mesh, drawn))


def _where(inverse: InverseProblem, fit: LinearFit) -> Iterator[RegionGap]:
    own = np.tile(inverse.points.interface, len(inverse.scans))
    z = np.tile(inverse.frame.normalised(inverse.points.points)[:, 2], len(inverse.scans))
    depths = {
        "all": np.ones(len(z), bool),
        "chest wall third": z < -1 / 3,
        "middle third": abs(z) <= 1 / 3,
        "nipple third": z > 1 / 3,
    }
    for number, scan in enumerate(inverse.scans):
        for interface, boundary in enumerate(INTERFACES):
            rows = (inverse.rows == number) & (own == interface)
            for region, inside in depths.items():
                chosen = rows & inside
                if chosen.sum() >= SETTINGS.gap.fewest_residuals:
                    yield region_gap(fit, chosen, scan.name, boundary.name, region)


def _constants(diagnosis: Diagnosis) -> dict[str, ConstantEstimate]:
    nominal, best = diagnosis.analysis.nominal, diagnosis.best
    before = nominal.values()
    after = best.fit.values() if best is not None else {}
    ends_before = _intervals(diagnosis, nominal)
    ends_after = {} if best is None else _intervals(diagnosis, best.fit)
    converged = (nominal if best is None else best.fit).converged
    is_in_law = best is not None and any(effect.is_in_law for effect in best.effects)
    constants = {}
    for free in diagnosis.analysis.inverse.free:
        to_door = free.unit.to_door
        constants[free.unit.name_at_door(free.name)] = ConstantEstimate(
            to_door(before[free.name]),
            to_door(after[free.name]) if free.name in after else None,
            _at_door(free, ends_before.get(free.name)),
            _at_door(free, ends_after.get(free.name)),
            (to_door(free.lower), to_door(free.upper)),
            converged,
            True if is_in_law and free.unit == KPA else None,
        )
    return constants


def _at_door(free: FreeConstant, ends: tuple[float, float] | None) -> tuple[float, float] | None:
    return None if ends is None else (free.unit.to_door(ends[0]), free.unit.to_door(ends[1]))


def _intervals(diagnosis: Diagnosis, fit: Fit) -> dict[str, tuple[float, float]]:
    """Return the 90 % intervals of the constants of a fit, in internal units.

    For scans they include the difference between solvers.
    """
    inverse = diagnosis.analysis.inverse
    solver_sd = SETTINGS.mesh.stiffness_sd if inverse.is_segmented else 0.0
    spread = _parameter_sd(inverse, fit)
    intervals = {}
    for i, free in enumerate(fit.unknowns.free):
        between = solver_sd if free.unit == KPA else 0.0
        reach = DEVIATIONS_90 * float(np.hypot(spread[i], between))
        here = float(fit.z[i])
        intervals[free.name] = (float(np.exp(here - reach)), float(np.exp(here + reach)))
    return intervals


def _parameter_sd(inverse: InverseProblem, fit: Fit) -> FloatArray:
    """Return the posterior standard deviation of each unknown of a fit, shape (p,)."""
    A = fit.linearised(inverse).scaled_nominal
    covariance = np.linalg.inv(np.eye(A.shape[1]) + A.T @ A)
    wider = SETTINGS.gap.solver_spread if inverse.is_segmented else 1.0
    return np.asarray(wider * np.sqrt(np.diag(covariance)) * fit.unknowns.sd)


def _joint_fit(diagnosis: Diagnosis, names: tuple[str, ...]) -> JointFitSummary:
    fit = diagnosis.joint_fits[names].fit
    is_named = set(names) == set(diagnosis.verdict.primary)
    return JointFitSummary(
        effects=names,
        log_evidence_gain=diagnosis.gain(names),
        field_gain=diagnosis.verdict.left_gain if is_named else None,
        converged=fit.converged,
        values=fit.values(),
    )


def _compared(found: Shrinkage) -> GapShrinkage:
    share = ShareEstimate(found.share, found.low, found.high)
    return GapShrinkage(_estimate(found.before), _estimate(found.after), share)


def _estimate(found: Gap) -> GapEstimate:
    return GapEstimate(found.gap_mm, found.low_mm, found.high_mm, found.noise_mm, found.points)
