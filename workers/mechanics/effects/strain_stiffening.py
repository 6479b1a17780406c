"""Let tissue stiffen as it is strained."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.effects.problem_changes import with_constants
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import Reading
from palpate.workers.units import NUMBER

NAME = "stiffening"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add to c2/mu of all tissues; one with a law of its own keeps that law."""

    def changed(c: Constants) -> Constants:
        return c if c.law else replace(c, stiffening=c.stiffening + values[NAME])

    return with_constants(problem, changed)


STIFFENING = Effect(
    name="strain_stiffening",
    family="global material",
    summary="The tissue stiffens as it is strained, more than a neo-Hookean body does.",
    parameters=(
        from_zero(
            NAME, NUMBER, 5.0, "c2/mu of Yeoh's law in all tissues", reading=Reading(name="c2/mu")
        ),
    ),
    prior_sd=(1.5,),
    steps=(1e-2,),
    transform=transform,
    references=(
        "A. Mira et al., Clin. Biomech. 60 (2018) 191",
        "P. S. Wellman, PhD thesis, Harvard University, 1999",
    ),
)
