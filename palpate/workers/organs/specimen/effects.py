"""Catalogue of effects that may explain a gap between a simulated and a measured specimen."""

from collections.abc import Sequence
from dataclasses import replace

from palpate.storage.values import Triple
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.effects.boundary import CLAMP_COMPLIANCE, base_motion
from palpate.workers.mechanics.effects.grips import ELASTIC_BED, GRIP_SLIP, load_cell_offset
from palpate.workers.mechanics.effects.loading import LOAD_SCALE, added_mass, self_weight
from palpate.workers.mechanics.effects.local_stiffness import STIFFNESS_GRADIENT
from palpate.workers.mechanics.effects.material import COMPRESSIBILITY, CREEP, STIFFENING
from palpate.workers.mechanics.effects.observation import FRAME_TURN, MARKER_STANDOFF
from palpate.workers.mechanics.effects.plugged import plugged_effects
from palpate.workers.mechanics.fem.problem.regions import Region
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
        effects += [load_cell_offset([one.mm_per_n for one in cells], OFFSET_PART * most_n)]
    return (*effects, base_motion(base_mm), FRAME_TURN, *plugged_effects("specimen"))
