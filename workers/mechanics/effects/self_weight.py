"""Add the weight of a body that was simulated without it."""

from dataclasses import dataclass, replace

from palpate.storage.values import Triple
from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.effects.problem_changes import plus
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import Reading
from palpate.workers.units import G

NAME = "self_weight"
# Of the density of a material that was cast or printed, relative.
DENSITY_SD = 0.02


@dataclass(frozen=True, slots=True)
class AddGravity:
    """Add a part of gravity along a unit vector."""

    down: Triple

    def __call__(self, problem: Problem, values: Values, frame: Frame) -> Problem:
        """Return the problem with the weight, see `Effect.transform`."""
        x, y, z = (values[NAME] * part for part in self.down)
        return replace(problem, gravity_g=plus(problem.gravity_g, (x, y, z)))


def self_weight(down: Triple) -> Effect:
    """Let gravity act along a known direction, of length 1.

    Unlike a change of posture neither direction nor size is a question: the body feels its
    weight or does not, and the weight is as certain as the density of its material.
    """
    return Effect(
        name="self_weight",
        family="loading",
        summary="The body sags under its own weight, which the model has not.",
        parameters=(
            from_zero(
                NAME,
                G,
                1.5,
                "part of its weight that the body feels",
                reading=Reading(unit="times its weight"),
            ),
        ),
        prior_sd=(1.0,),
        steps=(1e-2,),
        transform=AddGravity(down),
        if_present=((1.0, DENSITY_SD),),
        references=(
            "M. Dubied et al., IEEE Robot. Autom. Lett. 7 (2022) 5015: a beam of silicone",
        ),
    )
