"""What hides in the constants: how far each effect that no data can show would move them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from workers.diagnosis.diagnosis import Diagnosis
from workers.diagnosis.fit import Fit, fit
from workers.diagnosis.linear import Linearised
from workers.diagnosis.subject import unknowns
from workers.effects.base import Effect

Json = dict[str, Any]


def hidden(found: Diagnosis, effects: Sequence[Effect]) -> list[Json]:
    """The constants with and without each effect that they hide.

    An effect whose size is known if it acts is fitted with it. Of the others the change is
    that of the linear model, at one prior standard deviation.

    Parameters
    ----------
    found : Diagnosis
    effects : sequence of Effect
        The catalogue.

    Returns
    -------
    list of dict
        ``name``; ``size``, values of its parameters at the door; ``constants_kpa``, for each
        constant ``without`` and ``with`` the effect.
    """
    base = found.best.fit if found.best is not None else found.look.nominal
    before = constants_kpa(base)
    told = []
    for effect in effects:
        if effect.name not in found.verdict.hidden:
            continue
        size = dict(effect.plausible)
        after: Mapping[str, float] = linear_change(found, effect, before)
        if effect.if_present:
            size = {n: v for n, (v, _) in zip(effect.names, effect.if_present, strict=True)}
            after = fitted_with(found, base, effect, after) or after
        told.append(
            {
                "name": effect.name,
                "size": {p.door_name: p.unit.to_door(size[p.name]) for p in effect.parameters},
                "constants_kpa": {
                    name: {"without": before[name], "with": after[name]} for name in before
                },
            }
        )
    return told


def constants_kpa(at: Fit) -> dict[str, float]:
    """The free constants of a fit, in kPa."""
    return {name: 1e3 * v for name, v in at.unknowns.constants(at.z).items()}


def linear_change(
    found: Diagnosis, effect: Effect, before: Mapping[str, float]
) -> dict[str, float]:
    """Constants in kPa that make good for an effect of its plausible size."""
    look = found.look
    columns = look.prints[effect.name].places[0]
    away = np.array([effect.plausible[n] - effect.neutral[n] for n in effect.names])
    at: Linearised = look.linear
    A = at.scaled_nominal
    step = -np.linalg.solve(np.eye(A.shape[1]) + A.T @ A, A.T @ at.whiten(columns @ away))
    logs = step * at.nominal_sd
    return {name: v * float(np.exp(d)) for (name, v), d in zip(before.items(), logs, strict=True)}


def fitted_with(
    found: Diagnosis, base: Fit, effect: Effect, near: Mapping[str, float]
) -> dict[str, float] | None:
    """Constants in kPa with the effect added to a fit; None if that was not solved."""
    subject = found.look.subject
    free = unknowns(subject.free, (*base.unknowns.effects, effect))
    z = free.mean.copy()
    z[: len(base.z)] = base.z
    z[: len(near)] = np.log([1e-3 * v for v in near.values()])
    again = fit(subject, free, z, [None] * len(subject.scans))
    return None if again is None else constants_kpa(again)
