"""Let the clamp yield."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import MM_PER_KPA

NAME = "clamp_compliance"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Let the clamped face give way along its normal by so much under a unit of traction.

    Bending pulls on one side of the face and presses on the other, so that it turns.
    """
    wall, compliance = problem.wall, values[NAME]
    if not compliance or not wall.held[2]:
        return problem
    x, y, _ = wall.spring_mpa_per_mm
    held = (wall.held[0], wall.held[1], False)
    return replace(problem, wall=replace(wall, held=held, spring_mpa_per_mm=(x, y, 1 / compliance)))


# A layer of 3 mm of a material of 300 kPa gives way by 0.01 mm/kPa.
CLAMP_COMPLIANCE = Effect(
    name="clamp_compliance",
    family="boundary",
    summary="The clamp gives way where the body pulls and presses on it.",
    parameters=(
        from_zero(NAME, MM_PER_KPA, MM_PER_KPA.to_inside(0.5), "yield of the clamp under traction"),
    ),
    prior_sd=(MM_PER_KPA.to_inside(0.01),),
    steps=(MM_PER_KPA.to_inside(1e-4),),
    transform=transform,
    references=(
        "W. J. O'Donnell, J. Appl. Mech. 27 (1960) 461: the additional deflection of a "
        "cantilever due to the elasticity of the support",
    ),
)
