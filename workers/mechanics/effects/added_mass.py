"""Hang a mass on the body that was not weighed: markers, hooks, glue."""

from dataclasses import dataclass, replace

from palpate.storage.values import Triple
from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.fem.problem.boundary_value_problem import GRAVITY_MM_PER_S2, Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.fem.problem.loads import DeadForce
from palpate.workers.mechanics.fem.problem.regions import Region
from palpate.workers.units import Unit

NAME = "added_mass"
# Inside a mass is in t, so that t mm/s^2 is N.
GRAM = Unit("gram", "t", 1e6)


@dataclass(frozen=True, slots=True)
class AddMass:
    """Hang a mass on a region."""

    down: Triple
    region: Region

    def __call__(self, problem: Problem, values: Values, frame: Frame) -> Problem:
        """Return the problem with the mass, see `Effect.transform`."""
        x, y, z = (values[NAME] * GRAVITY_MM_PER_S2 * part for part in self.down)
        return replace(problem, forces=(*problem.forces, DeadForce((x, y, z), self.region)))


def added_mass(down: Triple, region: Region) -> Effect:
    """Hang a mass on `region`, pulled along the unit vector `down`, in all states alike."""
    return Effect(
        name="added_mass",
        family="loading",
        summary="Markers, hooks or glue weigh on the loaded place.",
        parameters=(
            from_zero(NAME, GRAM, GRAM.to_inside(50.0), "mass that hangs there in every state"),
        ),
        prior_sd=(GRAM.to_inside(5.0),),
        steps=(GRAM.to_inside(0.1),),
        transform=AddMass(down, region),
        references=("JCGM 100:2008, Guide to the expression of uncertainty in measurement",),
    )
