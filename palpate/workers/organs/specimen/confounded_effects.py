"""Change in the fitted stiffness due to each effect that the data cannot separate from it."""

from collections.abc import Mapping, Sequence

import numpy as np

from palpate.workers.diagnosis.algebra.linearisation import Linearised
from palpate.workers.diagnosis.fits.gauss_newton import Fit, fit
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.diagnosis.schema.experiment_summary import ConfoundedEffect
from palpate.workers.diagnosis.verdict.diagnosis import Diagnosis
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.units import KPA


def confounded_effects(
    diagnosis: Diagnosis, effects: Sequence[Effect]
) -> tuple[ConfoundedEffect, ...]:
    """Return the constants with and without each confounded effect.

    An effect whose size is known if present is included in a new fit. For the others the change
    is computed with the linear model, at one prior standard deviation.

    Parameters
    ----------
    diagnosis : Diagnosis
    effects : sequence of Effect
        The catalogue of effects.
    """
    best = diagnosis.best
    base = best.fit if best is not None else diagnosis.analysis.nominal
    free = [one for one in diagnosis.analysis.inverse.free if one.unit == KPA]
    before = base.unknowns.constants(base.z)
    confounded = []
    for effect in effects:
        if effect.name not in diagnosis.verdict.hidden:
            continue
        size = dict(effect.plausible)
        after: Mapping[str, float] = linear_change(diagnosis, effect, before)
        if effect.if_present:
            size = {n: v for n, (v, _) in zip(effect.names, effect.if_present, strict=True)}
            after = fitted_with(diagnosis, base, effect, after) or after
        confounded.append(
            ConfoundedEffect(
                effect.name,
                {p.door_name: p.unit.to_door(size[p.name]) for p in effect.parameters},
                {
                    one.name: {
                        "without": KPA.to_door(before[one.name]),
                        "with": KPA.to_door(after[one.name]),
                    }
                    for one in free
                },
            )
        )
    return tuple(confounded)


def linear_change(
    diagnosis: Diagnosis, effect: Effect, before: Mapping[str, float]
) -> dict[str, float]:
    """Return the constants that compensate for an effect of plausible size, by the linear model."""
    analysis = diagnosis.analysis
    columns = analysis.sensitivity_by_name[effect.name].places[0]
    away = np.array([effect.plausible[n] - effect.neutral[n] for n in effect.names])
    at: Linearised = analysis.linear
    A = at.scaled_nominal
    step = -np.linalg.solve(np.eye(A.shape[1]) + A.T @ A, A.T @ at.whiten(columns @ away))
    logs = step * at.nominal_sd
    return {name: v * float(np.exp(d)) for (name, v), d in zip(before.items(), logs, strict=True)}


def fitted_with(
    diagnosis: Diagnosis, base: Fit, effect: Effect, near: Mapping[str, float]
) -> dict[str, float] | None:
    """Return the constants of a fit with the effect added; None if it did not converge."""
    inverse = diagnosis.analysis.inverse
    free = unknowns(inverse.free, (*base.unknowns.effects, effect))
    z = free.mean.copy()
    z[: len(base.z)] = base.z
    z[: len(near)] = np.log(list(near.values()))
    again = fit(inverse, free, z, [None] * len(inverse.scans))
    return None if again is None else again.unknowns.constants(again.z)
