"""Stiffen tissue of one kind towards one side of the breast."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame, Gradient
from palpate.workers.mechanics.readings import ratio
from palpate.workers.units import NUMBER

NAMES = ("ln_gradient_x", "ln_gradient_y", "ln_gradient_z")


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Let the stiffness of all tissues grow exponentially along the axes."""
    x, y, z = (values[name] for name in NAMES)
    return replace(problem, variations=(Gradient((x, y, z), frame), *problem.variations))


STIFFNESS_GRADIENT = Effect(
    name="stiffness_gradient",
    family="global material",
    summary="Each tissue is stiffer on one side of the breast than on the other.",
    parameters=tuple(
        two_sided(
            name,
            NUMBER,
            1.0,
            f"ln of the stiffness from the middle to the end of {name[-1]}",
            reading=ratio(f"times as stiff at the end of {name[-1]} as in the middle"),
        )
        for name in NAMES
    ),
    prior_sd=(0.5, 0.5, 0.5),
    steps=(1e-4, 1e-4, 1e-4),
    transform=transform,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.5.7",
        "N. G. Ramião et al., Biomech. Model. Mechanobiol. 15 (2016) 1307",
    ),
)
