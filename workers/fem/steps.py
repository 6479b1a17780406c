"""In what steps a load is applied."""

from collections.abc import Iterator, Sequence

import numpy as np

from storage.errors import InputError
from storage.values import FloatArray
from workers.fem import friction
from workers.fem.contact import Gap, Surface, press
from workers.fem.level import Level, Stage, State
from workers.fem.loads import DistanceControl, ForceControl, Load
from workers.fem.model import Model
from workers.fem.problem import Problem

# The plates begin a little inside the body: without contact nothing resists.
OVERLAP_MM = 0.5
# A prolonged state may only just miss the plate.
BARELY_MM = 0.02
# Less than this is no contact: rounding.
TOUCH_MM = 1e-6


def stages_of(model: Model, problem: Problem) -> list[Stage]:
    """The moments at which every mesh is in equilibrium: one, or several with friction."""
    if not problem.load.device.friction:
        return [stage_at(model, problem.load, 1.0)]
    if not isinstance(problem.load, ForceControl | DistanceControl):
        raise InputError("Friction needs plates: give a plate force or a plate distance.")
    return [stage_at(model, problem.load, f) for f in path_fractions(problem.load)]


def routes(model: Model, problem: Problem) -> Iterator[list[Stage]]:
    """Ways to the full load, in more and more stages."""
    load = problem.load
    yield stages_of(model, problem)
    first = 2 * friction.STEPS if load.device.friction else 3
    for count in (first, 3 * first):
        yield [stage_at(model, load, f) for f in path_fractions(load, count)]


def path_fractions(load: Load, steps: int = friction.STEPS) -> list[float]:
    """Fractions of the load at the ends of its steps."""
    # Soft bodies yield like the root of the force: these steps are about equally long.
    power = 2 if isinstance(load, ForceControl) else 1
    return [float(f) for f in (np.arange(1, steps + 1) / steps) ** power]


def stage_at(model: Model, load: Load, fraction: float) -> Stage:
    """The load at a fraction of its full size."""
    if isinstance(load, ForceControl):
        gap = Gap(load.lower_mm, load.upper_mm)
        return Stage(gap, fraction * load.force_n, fraction, load.device)
    if isinstance(load, DistanceControl):
        goal = Gap(load.lower_mm, load.upper_mm)
        gap = open_gap(model, load).towards(goal, fraction)
        return Stage(gap, None, fraction, load.device)
    return Stage(None, None, fraction, load.device)


def open_gap(model: Model, load: Load) -> Gap:
    """Where flat plates would just touch the undeformed body."""
    axis = np.asarray(load.device.axis) / np.linalg.norm(load.device.axis)
    along = model.finest.nodes @ axis
    return Gap(float(along.min()), float(along.max()))


def ramps(load: Load) -> Sequence[int]:
    """Numbers of steps in which the coarsest mesh is tried, until one succeeds."""
    return (8, 24) if isinstance(load, DistanceControl) else (1, 4, 12)


def in_contact(level: Level, state: State, stage: Stage) -> State:
    """Let force-controlled plates begin where they touch the body."""
    x = _set_down(level, state.x, stage)
    if stage.force_n is None:
        return State(x, state.travel_mm)
    overlap = OVERLAP_MM if state.travel_mm == 0.0 else BARELY_MM
    return State(x, max(state.travel_mm, _first_touch_mm(level, x, stage) + overlap))


def _set_down(level: Level, x: FloatArray, stage: Stage) -> FloatArray:
    """Lay a body that nothing holds along the axis on the plate that stands still.

    Pushed from the other side it would fly, and its tangent be singular.
    """
    for plate in stage.plates(0.0):
        lowest = float(press(level.model.pads, x, plate).gap.min())
        if not plate.velocity.any() and lowest > -TOUCH_MM and _floats(level, plate):
            return np.asarray(x - (lowest + BARELY_MM) * plate.normal)
    return x


def _floats(level: Level, plate: Surface) -> bool:
    """Whether neither the wall nor a held place keeps the body from this plate."""
    across = np.abs(plate.normal) > 1e-6
    sprung = np.greater(level.problem.wall.spring_mpa_per_mm, 0)[across].any()
    if len(level.model.wall) and sprung:
        return False
    return bool(level.free[:, across].all())


def _first_touch_mm(level: Level, x: FloatArray, stage: Stage) -> float:
    """Travel at which every moving plate has reached the body."""
    travel = 0.0
    for _ in range(3):  # flat plates are there after the first round
        distances = [(press(level.model.pads, x, p), p) for p in stage.plates(travel)]
        reach = [
            float(found.gap.min()) / float(p.normal @ p.velocity)
            for found, p in distances
            if p.velocity.any()
        ]
        travel += max(reach)
    return travel
