"""Add a second family of fibres."""

from dataclasses import replace

from palpate.storage.values import Triple
from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.effects.problem_changes import with_constants
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import KPA

NAME = "second_fibres"


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add fibres across, normal to the compression and to the first family.

    Along the compression they would be slack, because fibres act in tension only. A
    problem that already has a second family keeps its direction.
    """
    there = any(c.second_fibre_mpa for c in problem.constants.values())
    fibres = problem.fibres

    def changed(c: Constants) -> Constants:
        return replace(c, second_fibre_mpa=c.second_fibre_mpa + values[NAME])

    axis = fibres.second_axis if there else _across(problem.load.device.axis)
    return replace(with_constants(problem, changed), fibres=replace(fibres, second_axis=axis))


def _across(axis: Triple) -> Triple:
    x, y, _ = axis
    return -y, x, 0.0


SECOND_FIBRES = Effect(
    name="second_fibres",
    family="global material",
    summary="Ligaments also run across the breast, between the plates.",
    parameters=(from_zero(NAME, KPA, KPA.to_inside(100.0), "stiffness of fibres that run across"),),
    prior_sd=(KPA.to_inside(30.0),),
    steps=(KPA.to_inside(0.1),),
    transform=transform,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.5.7",
        "C. Tanner et al., Med. Phys. 38 (2011) 682",
    ),
)
