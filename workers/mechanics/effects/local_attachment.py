"""Hold the breast at one place of its skin or of the chest wall."""

import math
from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Place, Values, from_zero, two_sided
from palpate.workers.mechanics.effects.problem_changes import plus
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.fem.problem.loads import Attachment
from palpate.workers.mechanics.parameters import Parameter
from palpate.workers.units import KPA_PER_MM, MM

STIFFNESS = ("attachment_stiffness_x", "attachment_stiffness_y", "attachment_stiffness_z")
PLACE = ("attachment_x", "attachment_y", "attachment_z")
RADIUS = "attachment_radius"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add springs on a patch of the boundary."""
    x, y, z = (values[name] for name in PLACE)
    kx, ky, kz = (values[name] for name in STIFFNESS)
    patch = Attachment((kx, ky, kz), plus(frame.centre_mm, (x, y, z)), values[RADIUS])
    return replace(problem, attachments=(*problem.attachments, patch)) if kx + ky + kz else problem


# 1 kPa/mm on a patch of 12 mm radius is 0.9 N/mm: nearly as firm as if the skin were glued. A
# long tether holds along itself alone, skin that sticks to a plate across it.
LOCAL_ATTACHMENT = Effect(
    name="local_attachment",
    family="boundary",
    summary="The breast is held at one place: by a tether, by a scar, by skin that sticks.",
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
                name, MM, 90.0, f"place of the attachment along {name[-1]} from the body's middle"
            )
            for name in PLACE
        ),
        Parameter(
            RADIUS, MM, 5.0, 30.0, 12.0, "radius of the attachment", admissible=(0.0, math.inf)
        ),
    ),
    prior_sd=(*(KPA_PER_MM.to_inside(1.0),) * 3, 40.0, 40.0, 40.0, 10.0),
    steps=(*(KPA_PER_MM.to_inside(1e-3),) * 3, 1e-3, 1e-3, 1e-3, 1e-3),
    transform=transform,
    references=(
        "A. Cooper, On the Anatomy of the Breast, London 1840",
        "J. H. Hipwell et al., Phys. Med. Biol. 61 (2016) R1",
    ),
    place=Place((*PLACE, RADIUS), "boundary", (12.0, 30.0)),
)
