"""Effects of supports and contact."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from palpate.storage.values import FloatArray, IntArray, Triple
from palpate.workers.mechanics.effects.effect import (
    Effect,
    Place,
    Values,
    from_zero,
    renamed,
    sum_of_vectors,
    two_sided,
    unchanged_problem,
    with_device,
)
from palpate.workers.mechanics.effects.observation_effects import rigid_columns
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem
from palpate.workers.mechanics.fem.loads_and_regions import Attachment
from palpate.workers.mechanics.model_parameters import (
    DEGREE,
    KPA_PER_MM,
    MM,
    MM_PER_KPA,
    NUMBER,
    Parameter,
    Reading,
)

# --- plate friction
# Let skin and plates rub.


PLATE_FRICTION_NAME = "friction"


def _plate_friction(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Increase the Coulomb friction coefficient."""
    return with_device(
        problem, lambda d: replace(d, friction=d.friction + values[PLATE_FRICTION_NAME])
    )


FRICTION = Effect(
    name="plate_friction",
    family="boundary",
    summary="The skin does not slide freely along the plates.",
    parameters=(
        from_zero(
            PLATE_FRICTION_NAME,
            NUMBER,
            1.0,
            "Coulomb friction coefficient between skin and plate",
            reading=Reading(name="coefficient"),
        ),
    ),
    prior_sd=(0.25,),
    steps=(0.001,),
    transform=_plate_friction,
    references=(
        "T.-C. Shih et al., Phys. Med. Biol. 55 (2010) 4153",
        "C. M. L. Hsu et al., Med. Phys. 38 (2011) 5756",
    ),
    is_slow=True,
    follows_path=True,
    truth=renamed(friction="coefficient"),
)


# --- wall compliance
# Let the chest wall yield under pressure.


WALL_COMPLIANCE_NAME = "wall_compliance"


def _wall_compliance(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Put a compliance in series with the support of the wall along z."""
    wall, compliance = problem.wall, values[WALL_COMPLIANCE_NAME]
    if not compliance:
        return problem
    x, y, stiffness = wall.spring_mpa_per_mm
    softer = 1 / compliance if wall.held[2] else stiffness / (1 + compliance * stiffness)
    held = (wall.held[0], wall.held[1], False)
    return replace(problem, wall=replace(wall, held=held, spring_mpa_per_mm=(x, y, softer)))


# Far from linear where it exceeds the compliance of the breast itself: its tangent at a
# fixed wall overestimates a large one.
WALL_COMPLIANCE = Effect(
    name="wall_compliance",
    family="boundary",
    summary="The chest wall yields under the pressure of the breast.",
    parameters=(
        from_zero(
            WALL_COMPLIANCE_NAME,
            MM_PER_KPA,
            MM_PER_KPA.to_inside(0.5),
            "yield of the chest wall under pressure",
        ),
    ),
    prior_sd=(MM_PER_KPA.to_inside(0.2),),
    steps=(MM_PER_KPA.to_inside(1e-4),),
    transform=_wall_compliance,
    references=("C. Tanner et al., Med. Phys. 33 (2006) 1758",),
    truth=renamed(wall_compliance_mm_per_kpa="compliance_mm_per_kpa"),
)


# --- wall hold
# Keep the breast from sliding freely along the chest wall.


WALL_HOLD_NAMES = ("wall_hold_x", "wall_hold_y")


def _wall_hold(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add springs along x and y where the wall is not held, in parallel with its own."""
    wall = problem.wall
    x, y = (
        0.0 if held else values[name]
        for name, held in zip(WALL_HOLD_NAMES, wall.held[:2], strict=True)
    )
    return replace(
        problem,
        wall=replace(wall, spring_mpa_per_mm=sum_of_vectors(wall.spring_mpa_per_mm, (x, y, 0.0))),
    )


# 10 kPa over 50 mm is 0.2 kPa/mm: a support that matters for the breast.
WALL_HOLD = Effect(
    name="wall_hold",
    family="boundary",
    summary="The breast is attached to the chest wall and does not slide along it.",
    parameters=tuple(
        from_zero(
            name,
            KPA_PER_MM,
            KPA_PER_MM.to_inside(1.0),
            f"stiffness of the attachment to the chest wall along {name[-1]}",
        )
        for name in WALL_HOLD_NAMES
    ),
    prior_sd=(KPA_PER_MM.to_inside(0.2),) * 2,
    steps=(KPA_PER_MM.to_inside(1e-3),) * 2,
    transform=_wall_hold,
    references=("M. A. Lago, PhD thesis, 2014, section 4.6",),
    holds_body=True,
)


# --- local attachment
# Hold the breast at one place of its skin or of the chest wall.


STIFFNESS = ("attachment_stiffness_x", "attachment_stiffness_y", "attachment_stiffness_z")
PLACE = ("attachment_x", "attachment_y", "attachment_z")
RADIUS = "attachment_radius"


def _local_attachment(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add springs on a patch of the boundary."""
    x, y, z = (values[name] for name in PLACE)
    kx, ky, kz = (values[name] for name in STIFFNESS)
    patch = Attachment((kx, ky, kz), sum_of_vectors(frame.centre_mm, (x, y, z)), values[RADIUS])
    return replace(problem, attachments=(*problem.attachments, patch)) if kx + ky + kz else problem


def _true_attachment(given: Mapping[str, Any]) -> dict[str, float]:
    """Return the springs: along all axes for a tether, along the chest wall for a scar.

    Springs are per area; a disc of radius R, the shape of a scar, has the total stiffness of a
    bell of radius R / sqrt(2).
    """
    is_scar = "radius_mm" in given
    grip, axes = float(given["grip_kpa_per_mm"]), "xy" if is_scar else "xyz"
    springs = {f"attachment_stiffness_{axis}_kpa_per_mm": grip for axis in axes}
    bell = {"attachment_radius_mm": given["radius_mm"] / math.sqrt(2)} if is_scar else {}
    return springs | bell


# 1 kPa/mm on a patch of 12 mm radius is 0.9 N/mm: nearly as firm as glued skin. A long tether
# holds only along itself; skin that sticks to a plate is held across it.
LOCAL_ATTACHMENT = Effect(
    name="local_attachment",
    family="boundary",
    summary="The breast is held at one place, for example by a tether, a scar or sticking skin.",
    parameters=(
        *(
            from_zero(
                name,
                KPA_PER_MM,
                KPA_PER_MM.to_inside(3.0),
                f"stiffness of the attachment along {name[-1]}, in its middle",
            )
            for name in STIFFNESS
        ),
        *(
            two_sided(
                name, MM, 90.0, f"position of the attachment along {name[-1]} from the body centre"
            )
            for name in PLACE
        ),
        Parameter(
            RADIUS, MM, 5.0, 30.0, 12.0, "radius of the attachment", admissible=(0.0, math.inf)
        ),
    ),
    prior_sd=(*(KPA_PER_MM.to_inside(1.0),) * 3, 40.0, 40.0, 40.0, 10.0),
    steps=(*(KPA_PER_MM.to_inside(1e-3),) * 3, 1e-3, 1e-3, 1e-3, 1e-3),
    transform=_local_attachment,
    references=(
        "A. Cooper, On the Anatomy of the Breast, London 1840",
        "J. H. Hipwell et al., Phys. Med. Biol. 61 (2016) R1",
    ),
    place=Place((*PLACE, RADIUS), "boundary", (12.0, 30.0)),
    is_slow=True,
    truth=_true_attachment,
)


# --- base motion
# Let the base move between the recordings at rest and under load.


SHIFTS = ("base_x", "base_y", "base_z")
TURNS = ("base_turn_x", "base_turn_y", "base_turn_z")


@dataclass(frozen=True, slots=True)
class BaseMotionColumns:
    """Columns of a rigid motion of the base, which rotates about `centre_mm`."""

    centre_mm: Triple

    def __call__(
        self, points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
    ) -> FloatArray:
        """Return the normal motion for 1 mm along and 1 degree about each axis, shape (k, 6)."""
        return rigid_columns(points, normals, self.centre_mm)


def base_motion(centre_mm: Triple) -> Effect:
    """Return the effect of a base that moves equally in all states, turning about `centre_mm`."""
    return Effect(
        name="base_motion",
        family="boundary",
        summary="The base, and the body with it, moved when the load was applied.",
        parameters=(
            *(two_sided(n, MM, 3.0, f"shift of the base along {n[-1]}") for n in SHIFTS),
            *(two_sided(n, DEGREE, 3.0, f"rotation of the base about {n[-1]}") for n in TURNS),
        ),
        prior_sd=(0.3,) * 3 + (0.3,) * 3,
        steps=(0.01,) * 6,
        transform=unchanged_problem,
        references=("J. M. Fitzpatrick, J. B. West, C. R. Maurer, IEEE TMI 17 (1998) 694",),
        observation=BaseMotionColumns(centre_mm),
    )


# --- clamp compliance
# Let the clamp yield.


CLAMP_COMPLIANCE_NAME = "clamp_compliance"


def _clamp_compliance(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Let the clamped face yield along its normal in proportion to the traction.

    Bending pulls on one side of the face and presses on the other, so the face rotates.
    """
    wall, compliance = problem.wall, values[CLAMP_COMPLIANCE_NAME]
    if not compliance or not wall.held[2]:
        return problem
    x, y, _ = wall.spring_mpa_per_mm
    held = (wall.held[0], wall.held[1], False)
    return replace(problem, wall=replace(wall, held=held, spring_mpa_per_mm=(x, y, 1 / compliance)))


# A 3 mm layer of a material of 300 kPa yields by 0.01 mm/kPa.
CLAMP_COMPLIANCE = Effect(
    name="clamp_compliance",
    family="boundary",
    summary="The clamp yields under the pull and pressure of the body.",
    parameters=(
        from_zero(
            CLAMP_COMPLIANCE_NAME,
            MM_PER_KPA,
            MM_PER_KPA.to_inside(0.5),
            "yield of the clamp under traction",
        ),
    ),
    prior_sd=(MM_PER_KPA.to_inside(0.01),),
    steps=(MM_PER_KPA.to_inside(1e-4),),
    transform=_clamp_compliance,
    references=(
        "W. J. O'Donnell, J. Appl. Mech. 27 (1960) 461: the additional deflection of a "
        "cantilever due to the elasticity of the support",
    ),
)
