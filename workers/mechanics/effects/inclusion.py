"""Put a hard or soft lump where the images do not show one."""

import math
from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Place, Values, two_sided
from palpate.workers.mechanics.effects.problem_changes import plus
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame, Inclusion
from palpate.workers.mechanics.parameters import Parameter
from palpate.workers.mechanics.readings import ratio
from palpate.workers.units import MM, NUMBER

RATIO, RADIUS = "inclusion_ln_ratio", "inclusion_radius"
PLACE = ("inclusion_x", "inclusion_y", "inclusion_z")


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the stiffness of all tissues in a ball."""
    x, y, z = (values[name] for name in PLACE)
    centre = plus(frame.centre_mm, (x, y, z))
    ball = Inclusion(values[RATIO], centre, values[RADIUS])
    return replace(problem, variations=(*problem.variations, ball)) if values[RATIO] else problem


INCLUSION = Effect(
    name="inclusion",
    family="local stiffness",
    summary="There is a lump, harder or softer than the tissue around it.",
    parameters=(
        two_sided(
            RATIO,
            NUMBER,
            2.7,
            "ln of the lump's stiffness over that of its surroundings",
            reading=ratio("times as stiff as its surroundings"),
        ),
        *(
            two_sided(name, MM, 60.0, f"place of the lump along {name[-1]} from the body's middle")
            for name in PLACE
        ),
        Parameter(RADIUS, MM, 3.0, 15.0, 6.0, "radius of the lump", admissible=(0.0, math.inf)),
    ),
    prior_sd=(1.5, 30.0, 30.0, 30.0, 4.0),
    steps=(1e-4, 1e-3, 1e-3, 1e-3, 1e-3),
    transform=transform,
    references=(
        "A. Samani, J. Zubovits, D. Plewes, Phys. Med. Biol. 52 (2007) 1565",
        "T. A. Krouskop et al., Ultrason. Imaging 20 (1998) 260",
    ),
    place=Place(PLACE, "inside"),
)
