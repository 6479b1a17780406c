"""The effects that are suspected when a simulated specimen differs from a measured one."""

from dataclasses import replace

from storage.values import Triple
from workers.effects.added_mass import added_mass
from workers.effects.base import Effect
from workers.effects.base_motion import base_motion
from workers.effects.clamp_compliance import CLAMP_COMPLIANCE
from workers.effects.compressibility import COMPRESSIBILITY
from workers.effects.creep import CREEP
from workers.effects.frame_turn import FRAME_TURN
from workers.effects.load_scale import LOAD_SCALE
from workers.effects.marker_standoff import MARKER_STANDOFF
from workers.effects.self_weight import self_weight
from workers.effects.stiffening import STIFFENING
from workers.effects.stiffness_gradient import STIFFNESS_GRADIENT
from workers.fem.regions import Region

GRADIENT = replace(
    STIFFNESS_GRADIENT, summary="The material is stiffer at one end of the body than at the other."
)
RELAXED = replace(
    CREEP, summary="The material has crept under its load since its stiffness was assumed."
)


def specimen_effects(
    down: Triple, base_mm: Triple, loaded: Region | None, weightless: bool, markers: bool,
    clamped: bool,
) -> tuple[Effect, ...]:  # fmt: skip
    """The catalogue of an experiment.

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
    """
    found: list[Effect] = [self_weight(down)] if weightless else []
    if loaded is not None:
        found += [LOAD_SCALE, added_mass(down, loaded)]
    if clamped:
        found += [CLAMP_COMPLIANCE]
    found += [GRADIENT, COMPRESSIBILITY, STIFFENING, RELAXED]
    if markers:
        found += [MARKER_STANDOFF]
    return (*found, base_motion(base_mm), FRAME_TURN)
