"""Let the chest wall yield under pressure."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import MM_PER_KPA

NAME = "wall_compliance"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Put a compliance in series with what holds the wall along z."""
    wall, compliance = problem.wall, values[NAME]
    if not compliance:
        return problem
    x, y, stiffness = wall.spring_mpa_per_mm
    softer = 1 / compliance if wall.held[2] else stiffness / (1 + compliance * stiffness)
    held = (wall.held[0], wall.held[1], False)
    return replace(problem, wall=replace(wall, held=held, spring_mpa_per_mm=(x, y, softer)))


# Far from linear where it exceeds the compliance of the breast itself: its tangent at a
# held wall promises more than a large one does.
WALL_COMPLIANCE = Effect(
    name="wall_compliance",
    family="boundary",
    summary="The chest wall gives way where the breast presses on it.",
    parameters=(
        from_zero(
            NAME, MM_PER_KPA, MM_PER_KPA.to_inside(0.5), "yield of the chest wall under pressure"
        ),
    ),
    prior_sd=(MM_PER_KPA.to_inside(0.2),),
    steps=(MM_PER_KPA.to_inside(1e-4),),
    transform=transform,
    references=("C. Tanner et al., Med. Phys. 33 (2006) 1758",),
)
