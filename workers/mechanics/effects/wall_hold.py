"""Hold the breast against sliding freely along the chest wall."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.effects.problem_changes import plus
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import KPA_PER_MM

NAMES = ("wall_hold_x", "wall_hold_y")


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add springs along x and y, in parallel to those of the wall, where it is not held."""
    wall = problem.wall
    x, y = (0.0 if held else values[name] for name, held in zip(NAMES, wall.held[:2], strict=True))
    return replace(
        problem, wall=replace(wall, spring_mpa_per_mm=plus(wall.spring_mpa_per_mm, (x, y, 0.0)))
    )


# 10 kPa over 50 mm is 0.2 kPa/mm: a hold that the breast feels.
WALL_HOLD = Effect(
    name="wall_hold",
    family="boundary",
    summary="The breast is attached to the chest wall and does not slide along it.",
    parameters=tuple(
        from_zero(
            name,
            KPA_PER_MM,
            KPA_PER_MM.to_inside(1.0),
            f"stiffness of the attachment to the chest wall along {name[-1]}",
        )
        for name in NAMES
    ),
    prior_sd=(KPA_PER_MM.to_inside(0.2),) * 2,
    steps=(KPA_PER_MM.to_inside(1e-3),) * 2,
    transform=transform,
    references=("M. A. Lago, PhD thesis, 2014, section 4.6",),
)
