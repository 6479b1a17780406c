"""Let fibres spread out instead of running parallel."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import DEGREE

NAMES = ("fibre_fan_x", "fibre_fan_y")


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Turn fibres the further, the farther they lie from the middle.

    Fibres that already spread keep the frame in which they do.
    """
    fibres = problem.fibres
    x, y = fibres.fan_deg
    spread = (x + values[NAMES[0]], y + values[NAMES[1]])
    where = fibres.frame if x or y else frame
    return replace(problem, fibres=replace(fibres, fan_deg=spread, frame=where))


FIBRE_FAN = Effect(
    name="fibre_fan",
    family="global material",
    summary="The ligaments spread out, or run together, towards the chest wall.",
    parameters=tuple(
        two_sided(
            name,
            DEGREE,
            30.0,
            f"turn of the fibres towards {name[-1]} from the middle to the end of {name[-1]}",
        )
        for name in NAMES
    ),
    prior_sd=(12.0, 12.0),
    steps=(1e-3, 1e-3),
    transform=transform,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.5.7",
        "C. Tanner et al., Med. Phys. 38 (2011) 682",
    ),
)
