"""Effects of the plates' shape and direction."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from palpate.workers.mechanics.effects.effect import (
    Effect,
    Values,
    from_zero,
    renamed,
    two_sided,
    with_device,
)
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem
from palpate.workers.mechanics.fem.loads_and_regions import Device
from palpate.workers.mechanics.fem.plate_surface import EDGE_RADIUS_MM
from palpate.workers.mechanics.model_parameters import DEGREE, MM

# --- plate tilt
# Tilt the upper plate relative to the lower one.


# A turn about the first in-plane axis lifts the plate along the depth, a turn about
# the second lifts it across.
PLATE_TILT_DEPTH, PLATE_TILT_ACROSS = "tilt_depth", "tilt_across"


def _plate_tilt(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Turn the upper plate about both in-plane axes."""

    def tilted(device: Device) -> Device:
        first, second = device.upper.tilt_deg
        turned = (first + values[PLATE_TILT_DEPTH], second + values[PLATE_TILT_ACROSS])
        return replace(device, upper=replace(device.upper, tilt_deg=turned))

    return with_device(problem, tilted)


PLATE_TILT = Effect(
    name="plate_tilt",
    family="plate geometry",
    summary="The upper plate is tilted.",
    parameters=(
        two_sided(
            PLATE_TILT_DEPTH, DEGREE, 5.0, "tilt of the upper plate from chest wall to nipple"
        ),
        two_sided(PLATE_TILT_ACROSS, DEGREE, 5.0, "tilt of the upper plate across the breast"),
    ),
    prior_sd=(2.5, 2.5),
    steps=(1e-4, 1e-4),
    transform=_plate_tilt,
    references=(
        "W. K. Ma et al., Br. J. Radiol. 89 (2016) 20150715: paddles that tilt by 0.04 to 0.69 "
        "degrees from side to side",
    ),
    truth=renamed(tilt_depth_deg="depth_deg", tilt_across_deg="across_deg"),
)


# --- plate flex
# Bend the upper plate.


# The first in-plane axis runs across, the second along the depth.
PLATE_FLEX_ACROSS, PLATE_FLEX_DEPTH = "flex_across", "flex_depth"
ARM_MM = 50.0


def _plate_flex(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Bend the upper plate into a parabola: ``sag = bow arm^2 / 2``."""

    def bent(device: Device) -> Device:
        bow = device.upper.bow_per_mm
        more = [2 * values[name] / ARM_MM**2 for name in (PLATE_FLEX_ACROSS, PLATE_FLEX_DEPTH)]
        return replace(
            device, upper=replace(device.upper, bow_per_mm=(bow[0] + more[0], bow[1] + more[1]))
        )

    return with_device(problem, bent)


PLATE_FLEX = Effect(
    name="plate_flex",
    family="plate geometry",
    summary="The upper plate bends away from the breast.",
    parameters=(
        two_sided(
            PLATE_FLEX_ACROSS,
            MM,
            8.0,
            f"sag of the upper plate {ARM_MM:g} mm across from its pivot",
        ),
        two_sided(
            PLATE_FLEX_DEPTH, MM, 8.0, f"sag of the upper plate {ARM_MM:g} mm deep from its pivot"
        ),
    ),
    prior_sd=(2.0, 2.0),
    steps=(1e-4, 1e-4),
    transform=_plate_flex,
    references=("M. Dustler et al., Acta Radiol. 62 (2021) 1583",),
)


# --- plate edge
# Let both plates begin in front of the chest wall.


PLATE_EDGE_NAME = "plate_edge"
# The pressure of a plate of a blind case rises over 4 mm, and a penalty needs little of it: bodies
# made with edges at 5 mm are best fitted by edges at 5.5 and 5.7 mm.
EDGE_FELT_MM = 0.5


def flat_from(edge_mm: float) -> float:
    """Return the distance from the wall at which a plate with this edge becomes flat, in mm.

    Its rounding is in front of its edge, and is smaller the nearer the edge is to the wall.
    """
    return edge_mm + EDGE_RADIUS_MM * (1 - math.exp(-edge_mm / EDGE_RADIUS_MM))


def _plate_edge(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Move the edge of both plates further from the wall."""
    if not values[PLATE_EDGE_NAME]:
        return problem
    wall_mm = frame.centre_mm[2] - frame.half_mm[2]

    def shorter(device: Device) -> Device:
        if device.edge_mm is not None:
            return replace(device, edge_mm=device.edge_mm + values[PLATE_EDGE_NAME])
        return replace(device, edge_mm=wall_mm + flat_from(values[PLATE_EDGE_NAME]))

    return with_device(problem, shorter)


def _true_plate_edge(given: Mapping[str, Any]) -> dict[str, float]:
    """Return the edge, half a millimetre beyond the place where the plate begins to press."""
    return {"plate_edge_mm": given["edge_mm"] + EDGE_FELT_MM}


PLATE_EDGE = Effect(
    name="plate_edge",
    family="plate geometry",
    summary="The plates begin in front of the chest wall, and tissue bulges behind their edge.",
    parameters=(
        from_zero(
            PLATE_EDGE_NAME,
            MM,
            20.0,
            "distance from the chest wall to the plates' edge, whose rounding has a radius of "
            f"{EDGE_RADIUS_MM:g} mm",
        ),
    ),
    prior_sd=(5.0,),
    # Points inside faces lose contact one by one: a longer step would include some such events.
    steps=(1e-5,),
    transform=_plate_edge,
    references=("M. Dustler et al., Acta Radiol. 53 (2012) 973",),
    is_slow=True,
    truth=_true_plate_edge,
)
