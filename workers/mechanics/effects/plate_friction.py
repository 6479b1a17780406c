"""Let skin and plates rub."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.effects.problem_changes import with_device
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import Reading
from palpate.workers.units import NUMBER

NAME = "friction"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add to Coulomb's coefficient."""
    return with_device(problem, lambda d: replace(d, friction=d.friction + values[NAME]))


FRICTION = Effect(
    name="plate_friction",
    family="boundary",
    summary="The skin does not slide freely along the plates.",
    parameters=(
        from_zero(
            NAME,
            NUMBER,
            1.0,
            "Coulomb's coefficient of skin on plate",
            reading=Reading(name="coefficient"),
        ),
    ),
    prior_sd=(0.25,),
    steps=(0.001,),
    transform=transform,
    references=(
        "T.-C. Shih et al., Phys. Med. Biol. 55 (2010) 4153",
        "C. M. L. Hsu et al., Med. Phys. 38 (2011) 5756",
    ),
)
