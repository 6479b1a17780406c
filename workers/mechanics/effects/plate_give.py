"""Let the upper plate tilt with the force that it carries."""

from dataclasses import replace

from workers.mechanics.effects.base import Effect, Values, two_sided
from workers.mechanics.effects.problem_changes import with_device
from workers.mechanics.fem.fields import Frame
from workers.mechanics.fem.loads import Device, ForceControl
from workers.mechanics.fem.problem import Problem
from workers.units import DEGREE_PER_N

# Turns about the in-plane axes, as those of `plate_tilt`.
DEPTH, ACROSS = "give_depth", "give_across"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Let the upper plate give way; plates at a stated distance stand as they stand."""
    if not isinstance(problem.load, ForceControl):
        return problem

    def giving(device: Device) -> Device:
        first, second = device.upper.give_deg_per_n
        more = (first + values[DEPTH], second + values[ACROSS])
        return replace(device, upper=replace(device.upper, give_deg_per_n=more))

    return with_device(problem, giving)


# A paddle that tilts by 2.5 degrees under 60 N.
PLATE_GIVE = Effect(
    name="plate_give",
    family="plate geometry",
    summary="The upper plate tilts under its force, twice as much under twice the force.",
    parameters=(
        two_sided(DEPTH, DEGREE_PER_N, 0.15, "tilt of the upper plate by its force, in depth"),
        two_sided(ACROSS, DEGREE_PER_N, 0.15, "tilt of the upper plate by its force, across"),
    ),
    prior_sd=(0.04, 0.04),
    steps=(1e-6, 1e-6),
    transform=transform,
    references=("I. H. R. Hauge et al., Med. Phys. 39 (2012) 263",),
    odds=0.3,
)
