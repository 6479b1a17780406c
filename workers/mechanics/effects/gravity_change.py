"""Let gravity differ between the two scans: another posture."""

from dataclasses import replace

from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.effects.problem_changes import plus
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import Reading
from palpate.workers.units import G

NAMES = ("gravity_x", "gravity_y", "gravity_z")


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add a body force to the one that the problem has."""
    x, y, z = (values[name] for name in NAMES)
    return replace(problem, gravity_g=plus(problem.gravity_g, (x, y, z)))


# A turn upside down changes gravity by 2 g.
GRAVITY_CHANGE = Effect(
    name="gravity_change",
    family="loading",
    summary="The body lay differently in the two scans, so gravity pulls another way.",
    parameters=tuple(
        two_sided(
            name,
            G,
            2.0,
            f"change of gravity along {name[-1]} between the scans",
            reading=Reading(unit=f"times gravity along {name[-1]}"),
        )
        for name in NAMES
    ),
    prior_sd=(0.3, 0.3, 0.3),
    steps=(0.01, 0.01, 0.01),
    transform=transform,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.6",
        "V. Rajagopal et al., Acad. Radiol. 15 (2008) 1425",
        "A. Mira et al., Clin. Biomech. 60 (2018) 191",
    ),
)
