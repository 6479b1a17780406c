"""Make tissue more, or less, compressible than assumed."""

import math
from dataclasses import replace

from palpate.workers.mechanics.effects.base import ANY, Effect, Values
from palpate.workers.mechanics.effects.problem_changes import with_constants
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.parameters import Parameter
from palpate.workers.mechanics.readings import poisson
from palpate.workers.units import NUMBER

NAME = "ln_compressibility"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply 1 - 2 nu of all tissues and keep Young's modulus.

    The bulk modulus E / 3(1 - 2 nu) falls by the same factor; the shear modulus
    E / 2(1 + nu) changes a little.
    """
    factor = math.exp(values[NAME])

    def changed(c: Constants) -> Constants:
        return replace(c, poisson=(1 - (1 - 2 * c.poisson) * factor) / 2)

    return with_constants(problem, changed)


# From nu = 0.499 to nu = 0.45 where the model has 0.49.
COMPRESSIBILITY = Effect(
    name="compressibility",
    family="global material",
    summary="The tissue loses more or less volume under pressure than assumed.",
    parameters=(
        Parameter(
            NAME,
            NUMBER,
            math.log(0.1),
            math.log(5.0),
            0.0,
            "ln of 1 - 2 nu over that of the model, at the same Young's modulus",
            admissible=ANY,
            reading=poisson(),
        ),
    ),
    prior_sd=(0.5,),
    steps=(1e-4,),
    transform=transform,
    references=("C. Tanner et al., Med. Phys. 33 (2006) 1758",),
)
