"""Let both plates begin in front of the chest wall."""

import math
from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.effects.problem_changes import with_device
from palpate.workers.mechanics.fem.contact.plate_surface import EDGE_RADIUS_MM
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.fem.problem.loads import Device
from palpate.workers.units import MM

NAME = "plate_edge"


def flat_from(edge_mm: float) -> float:
    """Return how far from the wall a plate that begins there is flat, in mm.

    Its rounding lies in front of its edge, and is as small as the edge is near the wall.
    """
    return edge_mm + EDGE_RADIUS_MM * (1 - math.exp(-edge_mm / EDGE_RADIUS_MM))


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Move the edge of both plates away from the wall, or further than it is."""
    if not values[NAME]:
        return problem
    wall_mm = frame.centre_mm[2] - frame.half_mm[2]

    def shorter(device: Device) -> Device:
        if device.edge_mm is not None:
            return replace(device, edge_mm=device.edge_mm + values[NAME])
        return replace(device, edge_mm=wall_mm + flat_from(values[NAME]))

    return with_device(problem, shorter)


PLATE_EDGE = Effect(
    name="plate_edge",
    family="plate geometry",
    summary="The plates begin in front of the chest wall, and tissue bulges behind their edge.",
    parameters=(
        from_zero(
            NAME,
            MM,
            20.0,
            "distance from the chest wall to the plates' edge, whose rounding has a radius of "
            f"{EDGE_RADIUS_MM:g} mm",
        ),
    ),
    prior_sd=(5.0,),
    # Points inside of faces let go one by one: a longer step would see some of them do so.
    steps=(1e-5,),
    transform=transform,
    references=("M. Dustler et al., Acta Radiol. 53 (2012) 973",),
)
