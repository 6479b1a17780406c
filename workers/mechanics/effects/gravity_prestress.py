"""Let gravity act in both scans alike: the image is not of a stress-free body."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.effects.problem_changes import plus
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import Reading
from palpate.workers.units import G

NAME = "common_gravity"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Let gravity along z act on the imaged body and under the load."""
    pull = (0.0, 0.0, values[NAME])
    return replace(
        problem,
        gravity_g=plus(problem.gravity_g, pull),
        imaged_gravity_g=plus(problem.imaged_gravity_g, pull),
    )


PRESTRESS = Effect(
    name="gravity_prestress",
    family="loading",
    summary="Gravity pulled the same way in both scans and had stretched the imaged body.",
    parameters=(
        two_sided(
            NAME,
            G,
            1.0,
            "gravity along z in both scans: 1 prone, -1 supine, 0 upright",
            reading=Reading(unit="times gravity along z"),
        ),
    ),
    prior_sd=(0.5,),
    steps=(0.05,),
    transform=transform,
    references=(
        "V. Rajagopal et al., Int. J. Numer. Methods Eng. 72 (2007) 1434",
        "S. Govindjee, P. A. Mihalic, Comput. Methods Appl. Mech. Eng. 136 (1996) 47",
    ),
)
