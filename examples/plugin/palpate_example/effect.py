"""An effect: a table that is not level pulls the breast to one side."""

from dataclasses import replace

from palpate.workers.mechanics.effects.effect import Effect, Values, two_sided
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem
from palpate.workers.mechanics.model_parameters import NUMBER

NAME = "side_weight"
PLAUSIBLE_G = 0.1


def tilted(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Return the problem with a part of the weight along x."""
    x, y, z = problem.gravity_g
    return replace(problem, gravity_g=(x + values[NAME], y, z))


SIDE_WEIGHT = Effect(
    name="side_weight",
    family="loading",
    summary="The table is not level, so a part of the weight pulls along x.",
    parameters=(two_sided(NAME, NUMBER, 0.5, "weight along x, as a multiple of gravity"),),
    prior_sd=(PLAUSIBLE_G,),
    steps=(1e-4,),
    transform=tilted,
    references=("this example",),
    organs=("breast",),
)
