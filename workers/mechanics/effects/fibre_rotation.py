"""Turn fibres away from the direction from chest wall to nipple."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import DEGREE

NAMES = ("fibre_turn_x", "fibre_turn_y")


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Turn all fibres towards x and y."""
    x, y = problem.fibres.turn_deg
    turned = (x + values[NAMES[0]], y + values[NAMES[1]])
    return replace(problem, fibres=replace(problem.fibres, turn_deg=turned))


FIBRE_ROTATION = Effect(
    name="fibre_rotation",
    family="global material",
    summary="The ligaments run in another direction than from chest wall to nipple.",
    parameters=tuple(
        two_sided(name, DEGREE, 30.0, f"turn of the fibres towards {name[-1]}") for name in NAMES
    ),
    prior_sd=(12.0, 12.0),
    steps=(1e-3, 1e-3),
    transform=transform,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.5.7",
        "C. Tanner et al., Med. Phys. 38 (2011) 682",
    ),
)
