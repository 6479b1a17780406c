"""List the effects that are suspected when a simulated breast differs from an imaged one."""

from collections.abc import Iterable

from palpate.storage.errors import InputError
from palpate.workers.mechanics.effects.base import Effect, Values
from palpate.workers.mechanics.effects.boundary import (
    FRICTION,
    LOCAL_ATTACHMENT,
    WALL_COMPLIANCE,
    WALL_HOLD,
)
from palpate.workers.mechanics.effects.loading import GRAVITY_CHANGE, PLATE_FORCE, PRESTRESS
from palpate.workers.mechanics.effects.local_stiffness import GROWTH, INCLUSION, STIFFNESS_GRADIENT
from palpate.workers.mechanics.effects.material import (
    COMPRESSIBILITY,
    COMPRESSIBILITY_CONTRAST,
    CREEP,
    FIBRE_CONTRAST,
    FIBRE_FAN,
    FIBRE_ROTATION,
    SECOND_FIBRES,
    SKIN_ADDED,
    SKIN_SCALED,
    STIFFENING,
)
from palpate.workers.mechanics.effects.observation import (
    IMAGE_SCALE,
    IMAGE_SHEAR,
    RIGID_MOTION,
    SEGMENTATION_OFFSET,
)
from palpate.workers.mechanics.effects.plates import PLATE_EDGE, PLATE_FLEX, PLATE_TILT
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.parameters import BREAST, Parameter, unknown_name

# Creep scales what the others have made, so it comes last among the materials.
BREAST_EFFECTS: tuple[Effect, ...] = (
    GRAVITY_CHANGE,
    PRESTRESS,
    PLATE_FORCE,
    PLATE_TILT,
    PLATE_FLEX,
    PLATE_EDGE,
    FRICTION,
    WALL_COMPLIANCE,
    WALL_HOLD,
    LOCAL_ATTACHMENT,
    STIFFNESS_GRADIENT,
    FIBRE_ROTATION,
    FIBRE_FAN,
    FIBRE_CONTRAST,
    SECOND_FIBRES,
    COMPRESSIBILITY,
    COMPRESSIBILITY_CONTRAST,
    STIFFENING,
    SKIN_ADDED,
    SKIN_SCALED,
    CREEP,
    INCLUSION,
    GROWTH,
    SEGMENTATION_OFFSET,
    RIGID_MOTION,
    IMAGE_SCALE,
    IMAGE_SHEAR,
)

# What is known to matter, or may, and cannot be named as a cause: it, or its nearest
# relative in the catalogue, will be found in its place.
NOT_SIMULATED: tuple[tuple[str, str], ...] = (
    (
        "tissue interface sliding",
        "gland and fat share their nodes; interfaces seen along their normals show little of it",
    ),
    (
        "oedema in one place",
        "fat and glandular tissue grow evenly, each by a volume of its own",
    ),
    (
        "tension of the skin at rest",
        "skin that is added is free of stress in the scan at rest",
    ),
    (
        "movement during the scan",
        "a body that moves while it is scanned is drawn blurred, not displaced",
    ),
    (
        "uneven chest wall",
        "the wall yields alike everywhere; a rib or the edge of the muscle does not",
    ),
    (
        "ligaments as sheets",
        "fibres act everywhere alike; a single stiff sheet looks like an inclusion",
    ),
    (
        "relaxation at different rates",
        "all moduli relax by the same part; only scans at several times tell tissues apart",
    ),
    (
        "plate that gives way with force",
        "tilt and sag are those of the final state; one that follows the force looks like a tilt",
    ),
    (
        "movement of the chest wall",
        "a breath that brings a part of the wall forward looks like a scan that lies elsewhere",
    ),
    (
        "corners and ends of the plates",
        "plates end at the chest wall alone, along a straight edge; elsewhere they are unlimited",
    ),
)


# The whole forward model: a study may hold or search any of it.
BREAST_MODEL = BREAST.extended_by(
    p for e in BREAST_EFFECTS if e.observation is None for p in e.parameters
)


def effect(name: str) -> Effect:
    """Return the effect of this name.

    Raises
    ------
    InputError
        If there is none; close names are suggested.
    """
    for candidate in BREAST_EFFECTS:
        if candidate.name == name:
            return candidate
    raise InputError(unknown_name("effect", name, (e.name for e in BREAST_EFFECTS)))


def effect_parameters(effects: Iterable[Effect] = BREAST_EFFECTS) -> tuple[Parameter, ...]:
    """Return the parameters of all effects, in order, to extend a vocabulary by."""
    return tuple(p for e in effects for p in e.parameters)


def with_effects(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Return `problem` with every effect of the catalogue, one after the other.

    Parameters
    ----------
    problem : Problem
        Without effects.
    values : mapping of str to float
        Inside names and units; effects whose parameters are not named are left out.
    frame : Frame
        Of the undeformed body.

    Raises
    ------
    InputError
        If no effect has a parameter of that name, or a value is not admissible.
    """
    known = [p.name for p in effect_parameters()]
    for name in values:
        if name not in known:
            raise InputError(unknown_name("parameter of an effect", name, known))
    for each in BREAST_EFFECTS:
        problem = each.apply(problem, {n: values[n] for n in each.names if n in values}, frame)
    return problem
