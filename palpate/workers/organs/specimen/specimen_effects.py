"""Catalogue of effects that may explain a gap between a simulated and a measured specimen.

For an effect that the data cannot separate from the fitted stiffness, the change of the stiffness
due to it is stated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from palpate.storage.values import Triple
from palpate.workers.diagnosis.fits.gauss_newton import Fit, fit
from palpate.workers.diagnosis.linearisation import Linearised
from palpate.workers.diagnosis.outcome.diagnosis_summary import ConfoundedEffect
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis
from palpate.workers.mechanics.effects.effect import Effect, plugged_effects
from palpate.workers.mechanics.effects.grip_effects import ELASTIC_BED, GRIP_SLIP, load_cell_offset
from palpate.workers.mechanics.effects.loading_effects import LOAD_SCALE, added_mass, self_weight
from palpate.workers.mechanics.effects.local_stiffness_effects import STIFFNESS_GRADIENT
from palpate.workers.mechanics.effects.material_effects import COMPRESSIBILITY, CREEP, STIFFENING
from palpate.workers.mechanics.effects.observation_effects import FRAME_TURN, MARKER_STANDOFF
from palpate.workers.mechanics.effects.support_effects import CLAMP_COMPLIANCE, base_motion
from palpate.workers.mechanics.fem.loads_and_regions import Region
from palpate.workers.mechanics.model_parameters import KPA
from palpate.workers.organs.specimen.load_cells import LoadCell

GRADIENT = replace(
    STIFFNESS_GRADIENT, summary="The material is stiffer at one end of the body than at the other."
)
RELAXED = replace(
    CREEP, summary="The material has crept under its load and is softer than assumed."
)

# Known or possible causes that have no effect here; a diagnosis will report "none of these" or
# the closest listed effect.
NOT_SIMULATED: tuple[tuple[str, str], ...] = (
    ("layers and inclusions", "each material is uniform in its part of the body"),
    ("fibres", "the law of the material is isotropic"),
    ("stress at rest", "the body is free of stress in the shape that the file describes"),
    ("friction", "held or loaded regions do not slide on a support"),
)
NO_STIFFENING = (
    "strain stiffening",
    "no material is neo-Hookean: the shape constants of its law describe stiffening",
)
BENDING = (
    "bending and wrinkles",
    "a sheet resists only stretching, and stays flat where it is compressed",
)
# A direction with a smaller component normal to a sheet is in its plane.
IN_PLANE = 1e-6
# Prior standard deviation of a load cell's offset, as a part of its largest reading: a zero set
# under a tenth of the load is a common mistake.
OFFSET_PART = 0.1


def specimen_effects(
    down: Triple,
    base_mm: Triple,
    loaded: Region | None,
    weightless: bool,
    markers: bool,
    clamped: bool,
    known_nu: bool,
    can_stiffen: bool = True,
    is_sheet: bool = False,
    moved: bool = False,
    cells: Sequence[LoadCell] = (),
    most_n: float = 0.0,
) -> tuple[Effect, ...]:
    """Return the catalogue of an experiment.

    Parameters
    ----------
    down : tuple of float
        Unit vector of gravity.
    base_mm : tuple of float
        Centre of the held regions.
    loaded : Region or None
        Region on which an added mass may hang; None if no force acts.
    weightless : bool
        Whether the model has no gravity.
    markers : bool
        Whether markers were observed, rather than points of the body itself.
    clamped : bool
        Whether the body is held at its lowest plane.
    known_nu : bool
        Whether all Poisson's ratios are fixed; a fitted one is a constant, not an effect.
    can_stiffen : bool
        Whether any material is neo-Hookean; other laws stiffen by their shape constants.
    is_sheet : bool
        Whether the body is a sheet, on which only weight in its plane has an effect.
    moved : bool
        Whether grips move regions of the body.
    cells : sequence of LoadCell
    most_n : float
        Largest reading of a load cell, in N.
    """
    is_felt = not is_sheet or abs(down[2]) < IN_PLANE
    effects: list[Effect] = [self_weight(down)] if weightless and is_felt else []
    if loaded is not None:
        effects += [LOAD_SCALE, *([added_mass(down, loaded)] if is_felt else [])]
    if clamped:
        effects += [CLAMP_COMPLIANCE]
    effects += [*([GRIP_SLIP] if moved else []), *([ELASTIC_BED] if is_sheet else [])]
    effects += [GRADIENT, *([COMPRESSIBILITY] if known_nu else [])]
    effects += [*([STIFFENING] if can_stiffen else []), RELAXED]
    if markers:
        effects += [MARKER_STANDOFF]
    if cells and most_n > 0:
        effects += [load_cell_offset([cell.mm_per_n for cell in cells], OFFSET_PART * most_n)]
    return (*effects, base_motion(base_mm), FRAME_TURN, *plugged_effects("specimen"))


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
    free = [constant for constant in diagnosis.analysis.inverse.free if constant.unit == KPA]
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
                    constant.name: {
                        "without": KPA.to_door(before[constant.name]),
                        "with": KPA.to_door(after[constant.name]),
                    }
                    for constant in free
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
    linear_model: Linearised = analysis.linear
    A = linear_model.scaled_nominal
    step = -np.linalg.solve(np.eye(A.shape[1]) + A.T @ A, A.T @ linear_model.whiten(columns @ away))
    logs = step * linear_model.nominal_sd
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
