"""Tilt the upper plate against the lower one."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.effects.problem_changes import with_device
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.fem.problem.loads import Device
from palpate.workers.units import DEGREE

# A turn about the first in-plane axis lifts the plate along the depth, and one about
# the second lifts it across.
DEPTH, ACROSS = "tilt_depth", "tilt_across"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Turn the upper plate about both in-plane axes."""

    def tilted(device: Device) -> Device:
        first, second = device.upper.tilt_deg
        turned = (first + values[DEPTH], second + values[ACROSS])
        return replace(device, upper=replace(device.upper, tilt_deg=turned))

    return with_device(problem, tilted)


PLATE_TILT = Effect(
    name="plate_tilt",
    family="plate geometry",
    summary="The upper plate is tilted.",
    parameters=(
        two_sided(DEPTH, DEGREE, 5.0, "tilt of the upper plate from chest wall to nipple"),
        two_sided(ACROSS, DEGREE, 5.0, "tilt of the upper plate across the breast"),
    ),
    prior_sd=(2.5, 2.5),
    steps=(1e-4, 1e-4),
    transform=transform,
    references=(
        "W. K. Ma et al., Br. J. Radiol. 89 (2016) 20150715: paddles that tilt by 0.04 to 0.69 "
        "degrees from side to side",
    ),
)
