"""Catalogue of effects that may explain a gap between a simulated and an imaged breast."""

from dataclasses import replace

from palpate.workers.mechanics.effects.effect import Catalogue, Effect, plugged_effects
from palpate.workers.mechanics.effects.loading_effects import GRAVITY_CHANGE, PLATE_FORCE, PRESTRESS
from palpate.workers.mechanics.effects.local_stiffness_effects import (
    GROWTH,
    INCLUSION,
    STIFFNESS_GRADIENT,
)
from palpate.workers.mechanics.effects.material_effects import (
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
from palpate.workers.mechanics.effects.observation_effects import (
    IMAGE_SCALE,
    IMAGE_SHEAR,
    RIGID_MOTION,
    SEGMENTATION_OFFSET,
)
from palpate.workers.mechanics.effects.plate_effects import PLATE_EDGE, PLATE_FLEX, PLATE_TILT
from palpate.workers.mechanics.effects.support_effects import (
    FRICTION,
    LOCAL_ATTACHMENT,
    WALL_COMPLIANCE,
    WALL_HOLD,
)
from palpate.workers.mechanics.model_parameters import BREAST
from palpate.workers.organs.organ_protocol import NuisanceEffect

# Under a force, free stiffnesses compensate for a wrong one: only their ratio can be measured.
CONFOUNDED_FORCE = replace(PLATE_FORCE, is_confounded=True)

# Creep scales the result of the other effects, so it comes last among the materials.
BREAST_EFFECTS: tuple[Effect, ...] = (
    GRAVITY_CHANGE,
    PRESTRESS,
    CONFOUNDED_FORCE,
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

# Known or possible causes that have no effect here; a diagnosis will report "none of these" or
# the closest listed effect.
NOT_SIMULATED: tuple[tuple[str, str], ...] = (
    (
        "tissue interface sliding",
        "gland and fat share their nodes; interfaces seen along their normals show little of it",
    ),
    ("oedema in one place", "growth is uniform within the fat and within the glandular tissue"),
    ("tension of the skin at rest", "skin that is added is free of stress in the scan at rest"),
    (
        "movement during the scan",
        "a body that moves while it is scanned appears blurred, not displaced",
    ),
    (
        "uneven chest wall",
        "the wall is equally compliant everywhere, unlike a rib or the edge of the muscle",
    ),
    ("ligaments as sheets", "fibres act uniformly; a single stiff sheet looks like an inclusion"),
    (
        "relaxation at different rates",
        "all moduli relax by the same fraction; only scans at several times separate the tissues",
    ),
    (
        "plate that gives way with force",
        "tilt and sag are those of the final state; one that follows the force looks like a tilt",
    ),
    (
        "movement of the chest wall",
        "a breath that brings a part of the wall forward looks like a shift of the scan",
    ),
    (
        "corners and ends of the plates",
        "plates end at the chest wall alone, along a straight edge; elsewhere they are unlimited",
    ),
)


# Nuisance parameters of a study: its intervals allow for parameters that it does not search.
LAW, VARIATION = "the law of the tissue", "the uniformity of the stiffness"
NUISANCES: tuple[NuisanceEffect, ...] = (
    NuisanceEffect(COMPRESSIBILITY, LAW),
    NuisanceEffect(STIFFENING, LAW),
    NuisanceEffect(FIBRE_CONTRAST, LAW),
    NuisanceEffect(SECOND_FIBRES, LAW),
    NuisanceEffect(STIFFNESS_GRADIENT, VARIATION),
    # Skin on a plate slides with a coefficient of a few tenths. Friction saturates: it is
    # differentiated by a step of its own size, a fiftieth of this interval.
    NuisanceEffect(FRICTION, "the friction of the plates", sd=0.3, interval=(0.0, 15.0)),
    NuisanceEffect(RIGID_MOTION, "the place of the scan", of="image"),
    # For each side of a scan: a wrong voxel size is off by several per cent, distortion by less.
    NuisanceEffect(IMAGE_SCALE, "the scale of the scan", sd=0.015, of="image"),
    # For the force shown by a device: four in five are right within a tenth.
    NuisanceEffect(
        CONFOUNDED_FORCE, "the force", sd=0.08, interval=(-1.0, 1.0), of="force", always=True
    ),
)

CATALOGUE = Catalogue((*BREAST_EFFECTS, *plugged_effects("breast")), NOT_SIMULATED)

# All parameters of the forward model: a study may hold or search any of them.
BREAST_MODEL = BREAST.extended_by(p for e in CATALOGUE.on_body for p in e.parameters)
