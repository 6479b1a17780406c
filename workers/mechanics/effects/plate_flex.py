"""Bend the upper plate."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.effects.problem_changes import with_device
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.fem.problem.loads import Device
from palpate.workers.units import MM

# Across lies the first in-plane axis, and the depth along the second.
ACROSS, DEPTH = "flex_across", "flex_depth"
ARM_MM = 50.0


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Bend the upper plate to a parabola: ``sag = bow arm^2 / 2``."""

    def bent(device: Device) -> Device:
        bow = device.upper.bow_per_mm
        more = [2 * values[name] / ARM_MM**2 for name in (ACROSS, DEPTH)]
        return replace(
            device, upper=replace(device.upper, bow_per_mm=(bow[0] + more[0], bow[1] + more[1]))
        )

    return with_device(problem, bent)


PLATE_FLEX = Effect(
    name="plate_flex",
    family="plate geometry",
    summary="The upper plate bends away from the breast.",
    parameters=(
        two_sided(ACROSS, MM, 8.0, f"sag of the upper plate {ARM_MM:g} mm across from its pivot"),
        two_sided(DEPTH, MM, 8.0, f"sag of the upper plate {ARM_MM:g} mm deep from its pivot"),
    ),
    prior_sd=(2.0, 2.0),
    steps=(1e-4, 1e-4),
    transform=transform,
    references=("M. Dustler et al., Acta Radiol. 62 (2021) 1583",),
)
