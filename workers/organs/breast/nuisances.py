"""Nuisance parameters of a breast study: place and scale of the scan, load, law of the tissue."""

from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.effects.breast_catalogue import effect
from palpate.workers.organs.breast.spec import LoadSpec
from palpate.workers.organs.nuisances import Nuisance

PLACE, SCALE, FORCE = "the place of the scan", "the scale of the scan", "the force"
FRICTION = "the friction of the plates"
LAW, VARIATION = "the law of the tissue", "the evenness of the stiffness"
# Of a force that a device shows: four in five are right within a tenth.
FORCE_SD = 0.08
# Of each side of a scan: a wrong voxel size is off by per cents, distortion by less.
SCALE_SD = 0.015
# Skin on a plate slides with a coefficient of a few tenths.
FRICTION_SD = 0.3
# Friction saturates: it is differentiated by a step of its own size, a fiftieth of this.
FRICTION_SPAN = 15.0


def nuisances(load: LoadSpec, imaged: bool) -> tuple[Nuisance, ...]:
    """Return the nuisance parameters of a target under a load; see `Organ.nuisances`."""
    found = [
        *_of(effect("compressibility"), LAW),
        *_of(effect("strain_stiffening"), LAW),
        *_of(effect("fibre_contrast"), LAW),
        *_of(effect("second_fibres"), LAW),
        *_of(effect("stiffness_gradient"), VARIATION),
        Nuisance("friction", FRICTION, FRICTION_SD, 0.0, FRICTION_SPAN),
    ]
    if not imaged:
        return tuple(found)
    found += _of(effect("rigid_motion"), PLACE)
    found += _of(effect("image_scale"), SCALE, SCALE_SD)
    if load.force_n is not None:
        found.append(Nuisance("ln_plate_force", FORCE, FORCE_SD, -1.0, 1.0, always=True))
    return tuple(found)


def _of(one: Effect, group: str, stated_sd: float | None = None) -> list[Nuisance]:
    return [
        Nuisance(p.name, group, stated_sd or sd, p.lower, p.upper)
        for p, sd in zip(one.parameters, one.prior_sd, strict=True)
    ]
