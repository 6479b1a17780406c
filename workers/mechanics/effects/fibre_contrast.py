"""Let the fibres of glandular tissue be stiffer, or softer, than those of fat."""

import math
from dataclasses import replace

from palpate.storage.values import Tissue
from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import ratio
from palpate.workers.units import NUMBER

NAME = "ln_fibre_contrast"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the stiffness of both families of fibres in glandular tissue."""
    factor = math.exp(values[NAME])
    gland = problem.constants.get(Tissue.GLANDULAR)
    if gland is None:
        return problem
    changed = replace(
        gland,
        fibre_mpa=factor * gland.fibre_mpa,
        second_fibre_mpa=factor * gland.second_fibre_mpa,
    )
    return replace(problem, constants={**problem.constants, Tissue.GLANDULAR: changed})


FIBRE_CONTRAST = Effect(
    name="fibre_contrast",
    family="global material",
    summary="Fibres of glandular tissue and of fat are not equally stiff.",
    parameters=(
        two_sided(
            NAME,
            NUMBER,
            2.0,
            "ln of the stiffness of glandular fibres over that of the model",
            reading=ratio("times as stiff as the model's fibres"),
        ),
    ),
    prior_sd=(0.7,),
    steps=(1e-4,),
    transform=transform,
    references=("M. A. Lago, PhD thesis, 2014, section 4.5.1",),
)
