"""Scale the share of the plate's force that goes through the breast."""

import math
from dataclasses import replace

from palpate.workers.mechanics.effects.base import ANY, Effect, Values
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.fem.problem.loads import ForceControl
from palpate.workers.mechanics.parameters import Parameter
from palpate.workers.mechanics.readings import ratio
from palpate.workers.units import NUMBER

NAME = "ln_plate_force"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the force; plates that stand at a distance stay there."""
    load = problem.load
    if not isinstance(load, ForceControl):
        return problem
    return replace(problem, load=replace(load, force_n=load.force_n * math.exp(values[NAME])))


# Between the least share measured with rigid plates and a sensor that reads 15 % low.
PLATE_FORCE = Effect(
    name="plate_force",
    family="loading",
    summary="Part of the plate's force goes through the chest wall, or its sensor is off.",
    parameters=(
        Parameter(
            NAME,
            NUMBER,
            math.log(0.14),
            math.log(1.15),
            0.0,
            "ln of the share of the plate's force that the breast carries",
            admissible=ANY,
            reading=ratio("times the stated force"),
        ),
    ),
    prior_sd=(0.5,),
    steps=(1e-4,),
    transform=transform,
    references=(
        "M. Dustler et al., Acta Radiol. 62 (2021) 1583: rigid plates put 22 % (CC) and "
        "14 % (MLO) of their force on the breast",
    ),
)
