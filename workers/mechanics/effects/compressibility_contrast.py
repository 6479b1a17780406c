"""Let glandular tissue be more, or less, compressible than fat."""

import math
from dataclasses import replace

from palpate.storage.values import Tissue
from palpate.workers.mechanics.effects.base import ANY, Effect, Values
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.parameters import Parameter
from palpate.workers.mechanics.readings import poisson
from palpate.workers.units import NUMBER

NAME = "ln_compressibility_contrast"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply 1 - 2 nu of glandular tissue and keep its Young's modulus."""
    gland = problem.constants.get(Tissue.GLANDULAR)
    if gland is None:
        return problem
    factor = math.exp(values[NAME])
    changed = replace(gland, poisson=(1 - (1 - 2 * gland.poisson) * factor) / 2)
    return replace(problem, constants={**problem.constants, Tissue.GLANDULAR: changed})


COMPRESSIBILITY_CONTRAST = Effect(
    name="compressibility_contrast",
    family="global material",
    summary="Glandular tissue and fat do not lose the same part of their volume under pressure.",
    parameters=(
        Parameter(
            NAME,
            NUMBER,
            math.log(0.1),
            math.log(5.0),
            0.0,
            "ln of 1 - 2 nu of glandular tissue over that of the model",
            admissible=ANY,
            reading=poisson("nu of glandular tissue"),
        ),
    ),
    prior_sd=(0.5,),
    steps=(1e-4,),
    transform=transform,
    references=("C. Tanner et al., Med. Phys. 33 (2006) 1758",),
    odds=0.3,
)
