"""Add skin that the model lacks, or has too thin or too soft."""

import math
from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, from_zero, two_sided
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Membrane, Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import ratio
from palpate.workers.units import N_PER_M, NUMBER

ADDED, FACTOR = "skin_added", "ln_skin"
# A sheet feels E t alone; where there is none yet, this says how it is split.
THICKNESS_MM = 1.5


def add(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add to the stiffness E t of the membrane, and make one where there is none."""
    if not values[ADDED]:
        return problem
    skin = problem.membrane
    if skin is None:
        thicker = Membrane(values[ADDED] / THICKNESS_MM, THICKNESS_MM)
    else:
        thicker = replace(skin, young_mpa=skin.young_mpa + values[ADDED] / skin.thickness_mm)
    return replace(problem, membrane=thicker)


def scale(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the stiffness of the membrane, where there is one."""
    skin = problem.membrane
    if skin is None:
        return problem
    return replace(
        problem, membrane=replace(skin, young_mpa=skin.young_mpa * math.exp(values[FACTOR]))
    )


REFERENCES = (
    "M. A. Lago, PhD thesis, 2014, section 4.5.7",
    "J. A. Solves Llorens et al., Sci. World J. 2012, 876489",
)

SKIN_ADDED = Effect(
    name="skin_added",
    family="global material",
    summary="The skin adds a stiffness that the model does not have.",
    parameters=(
        from_zero(
            ADDED, N_PER_M, N_PER_M.to_inside(5000.0), "E t of the skin on top of the model's"
        ),
    ),
    prior_sd=(N_PER_M.to_inside(1000.0),),
    steps=(N_PER_M.to_inside(10.0),),
    transform=add,
    references=REFERENCES,
)

SKIN_SCALED = Effect(
    name="skin_scaled",
    family="global material",
    summary="The skin of the model is too stiff or too soft, too thick or too thin.",
    parameters=(
        two_sided(
            FACTOR,
            NUMBER,
            1.5,
            "ln of E t of the skin over that of the model",
            reading=ratio("times as stiff as the model's skin"),
        ),
    ),
    prior_sd=(0.5,),
    steps=(1e-4,),
    transform=scale,
    references=REFERENCES,
)
