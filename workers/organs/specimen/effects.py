"""The effects that are suspected when a simulated specimen differs from a measured one."""

from dataclasses import replace

from palpate.storage.values import Triple
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.effects.boundary import CLAMP_COMPLIANCE, base_motion
from palpate.workers.mechanics.effects.loading import LOAD_SCALE, added_mass, self_weight
from palpate.workers.mechanics.effects.local_stiffness import STIFFNESS_GRADIENT
from palpate.workers.mechanics.effects.material import COMPRESSIBILITY, CREEP, STIFFENING
from palpate.workers.mechanics.effects.observation import FRAME_TURN, MARKER_STANDOFF
from palpate.workers.mechanics.effects.plugged import plugged_effects
from palpate.workers.mechanics.fem.problem.regions import Region

GRADIENT = replace(
    STIFFNESS_GRADIENT, summary="The material is stiffer at one end of the body than at the other."
)
RELAXED = replace(
    CREEP, summary="The material has crept under its load since its stiffness was assumed."
)

# Known or possible causes that have no effect here; a diagnosis will report "none of these" or
# the closest listed effect.
NOT_SIMULATED: tuple[tuple[str, str], ...] = (
    ("slip in a grip", "regions that are moved follow exactly what is stated or measured"),
    ("layers and inclusions", "each material is the same everywhere in its part of the body"),
    ("fibres", "the law of the material has no direction"),
    ("stress at rest", "the body is free of stress in the shape that the file describes"),
    ("friction", "places that are held or loaded do not slide against a support"),
)
NO_STIFFENING = (
    "strain stiffening",
    "no material is neo-Hookean: the shape constants of its law say how it stiffens",
)
BENDING = (
    "bending and wrinkles",
    "a sheet resists stretching alone, and stays flat where it is compressed",
)
# A direction whose part across a sheet is smaller lies in its plane.
IN_PLANE = 1e-6


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
) -> tuple[Effect, ...]:
    """Return the catalogue of an experiment.

    Parameters
    ----------
    down : tuple of float
        Direction of gravity, of length 1.
    base_mm : tuple of float
        Middle of the places that are held.
    loaded : Region or None
        Where something may hang; None if no force acts.
    weightless : bool
        Whether the model has no gravity.
    markers : bool
        Whether markers were observed, and not points of the body itself.
    clamped : bool
        Whether the body is held by the plane in which it ends.
    known_nu : bool
        Whether Poisson's ratios are stated: one that is searched is a constant, no effect.
    can_stiffen : bool
        Whether any material is neo-Hookean; the shape constants of other laws say how they stiffen.
    is_sheet : bool
        Whether the body is a sheet, whose weight is felt in its plane only.
    """
    is_felt = not is_sheet or abs(down[2]) < IN_PLANE
    effects: list[Effect] = [self_weight(down)] if weightless and is_felt else []
    if loaded is not None:
        effects += [LOAD_SCALE, *([added_mass(down, loaded)] if is_felt else [])]
    if clamped:
        effects += [CLAMP_COMPLIANCE]
    effects += [GRADIENT, *([COMPRESSIBILITY] if known_nu else [])]
    effects += [*([STIFFENING] if can_stiffen else []), RELAXED]
    if markers:
        effects += [MARKER_STANDOFF]
    return (*effects, base_motion(base_mm), FRAME_TURN, *plugged_effects("specimen"))
