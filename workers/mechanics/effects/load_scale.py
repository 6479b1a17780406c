"""Make forces larger or smaller than written down."""

import math
from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import ratio
from palpate.workers.units import NUMBER

NAME = "ln_load"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply all forces; gravity is known better and stays."""
    factor = math.exp(values[NAME])
    forces = []
    for dead in problem.forces:
        x, y, z = dead.force_n
        forces.append(replace(dead, force_n=(factor * x, factor * y, factor * z)))
    return replace(problem, forces=tuple(forces))


# Without gravity or a prescribed displacement the stiffness takes all of it.
LOAD_SCALE = Effect(
    name="load_scale",
    family="loading",
    summary="The forces are not what was written down: scales, friction, a lever arm.",
    parameters=(
        two_sided(
            NAME,
            NUMBER,
            0.3,
            "ln of the true forces over those stated",
            reading=ratio("times the stated forces"),
        ),
    ),
    prior_sd=(0.05,),
    steps=(1e-4,),
    transform=transform,
    references=("JCGM 100:2008, Guide to the expression of uncertainty in measurement",),
)
