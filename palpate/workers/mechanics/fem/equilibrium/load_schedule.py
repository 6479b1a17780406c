"""Stages of a load, and starting positions of force-controlled plates."""

from collections.abc import Iterator, Sequence

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.contact.plate_surface import Gap, PlateSurface
from palpate.workers.mechanics.fem.contact.plates import plate_contact
from palpate.workers.mechanics.fem.elements.model import Model
from palpate.workers.mechanics.fem.elements.states import Stage, State
from palpate.workers.mechanics.fem.linear.level import Level
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.loads import Device, DistanceControl, ForceControl, Load

# The plates begin slightly inside the body: without contact there is no resistance.
OVERLAP_MM = 0.5
# A prolonged state may only just miss the plate.
PROLONGED_OVERLAP_MM = 0.02
# Less than this is rounding, not contact.
TOUCH_MM = 1e-6
# Newton steps on the travel alone; between flat plates three are enough.
TRAVEL_STEPS = 6


def load_stages(model: Model, problem: Problem) -> list[Stage]:
    """Return the stages at which every mesh is in equilibrium: one, or several with friction.

    Raises
    ------
    InputError
        If there is friction but no plate.
    """
    if not problem.load.device.friction:
        return [stage_at(model, problem.load, 1.0)]
    if not isinstance(problem.load, ForceControl | DistanceControl):
        raise InputError("Friction needs plates: give a plate force or a plate distance.")
    return [stage_at(model, problem.load, f) for f in friction_fractions(problem)]


def load_schedules(model: Model, problem: Problem) -> Iterator[list[Stage]]:
    """Yield schedules to the full load, with more and more stages."""
    load = problem.load
    yield load_stages(model, problem)
    first = 2 * problem.friction_steps if load.device.friction else 3
    for count in (first, 3 * first):
        yield [stage_at(model, load, f) for f in load_fractions(load, count)]


def friction_fractions(problem: Problem) -> list[float]:
    """Return the fractions of the load at the ends of the friction steps."""
    return load_fractions(problem.load, problem.friction_steps)


def load_fractions(load: Load, steps: int) -> list[float]:
    """Return the fractions of the load at the ends of `steps` steps."""
    # Displacements of soft bodies grow like the root of the force: these steps are about equal.
    power = 2 if isinstance(load, ForceControl) else 1
    return [float(f) for f in (np.arange(1, steps + 1) / steps) ** power]


def stage_at(model: Model, load: Load, fraction: float) -> Stage:
    """Return the load at a fraction of its full size."""
    if isinstance(load, ForceControl):
        gap = Gap(load.lower_mm, load.upper_mm)
        return Stage(gap, fraction * load.force_n, fraction, load.device)
    if isinstance(load, DistanceControl):
        goal = Gap(load.lower_mm, load.upper_mm)
        gap = touching_gap(model.finest.nodes, load.device).towards(goal, fraction)
        return Stage(gap, None, fraction, load.device)
    return Stage(None, None, fraction, load.device)


def touching_gap(nodes: FloatArray, device: Device) -> Gap:
    """Return the gap of flat plates that just touch the undeformed `nodes`, shape (n, 3)."""
    axis = np.asarray(device.axis) / np.linalg.norm(device.axis)
    along = nodes @ axis
    return Gap(float(along.min()), float(along.max()))


def coarsest_increments(load: Load) -> Sequence[int]:
    """Return the numbers of steps to try on the coarsest mesh, in order."""
    return (8, 24) if isinstance(load, DistanceControl) else (1, 4, 12)


def bring_into_contact(level: Level, state: State, stage: Stage) -> State:
    """Start force-controlled plates where they touch the body."""
    x = _set_down(level, state.x, stage)
    if stage.force_n is None:
        return state.moved_to(x, state.travel_mm)
    overlap = OVERLAP_MM if state.travel_mm == 0.0 else PROLONGED_OVERLAP_MM
    touching = _first_touch_mm(level, x, stage)
    return state.moved_to(x, max(state.travel_mm, touching + overlap))


def better_start(level: Level, state: State, stage: Stage, expected_mm: FloatArray) -> State:
    """Move the nodes of a state by `expected_mm`, (n, 3), if that lowers the energy.

    The plates follow until they carry their force.
    """
    x = level.with_prescribed(state.x + expected_mm, stage.fraction)
    there = bring_into_contact(level, state.moved_to(x, state.travel_mm), stage)
    there = _carried(level, there, stage)
    energies = [level.energy(one, stage).potential for one in (there, state)]
    return there if energies[0] < energies[1] else state


def _carried(level: Level, state: State, stage: Stage) -> State:
    """Move force-controlled plates until they carry their force, with the body held fixed."""
    if stage.force_n is None:
        return state
    for _ in range(TRAVEL_STEPS):
        _, contact = level.contact(state, stage)
        if contact.travel_stiffness <= 0:
            break
        closed = (stage.force_n - contact.travel_force) / contact.travel_stiffness
        state = state.moved_to(state.x, state.travel_mm + closed)
        if abs(closed) < level.problem.tolerance_mm:
            break
    return state


def _set_down(level: Level, x: FloatArray, stage: Stage) -> FloatArray:
    """Place a body without support along the axis on the plate that does not move.

    Pushed from the other side it would move freely, and its tangent would be singular.
    """
    for plate in stage.plates(0.0):
        lowest = float(plate_contact(level.model.contact_nodes, x, plate).gap.min())
        if not plate.velocity.any() and lowest > -TOUCH_MM and _floats(level, plate):
            return np.asarray(x - (lowest + PROLONGED_OVERLAP_MM) * plate.normal)
    return x


def _floats(level: Level, plate: PlateSurface) -> bool:
    """Test whether neither the wall nor a hold keeps the body from moving towards this plate."""
    across = np.abs(plate.normal) > 1e-6
    sprung = np.greater(level.problem.wall.spring_mpa_per_mm, 0)[across].any()
    if len(level.model.wall) and sprung:
        return False
    return bool(level.free[:, across].all())


def _first_touch_mm(level: Level, x: FloatArray, stage: Stage) -> float:
    """Return the travel at which every moving plate has reached the body."""
    travel = 0.0
    for _ in range(3):  # flat plates need only one round
        moving = [p for p in stage.plates(travel) if p.velocity.any()]
        travel += max(
            float(plate_contact(level.model.contact_nodes, x, p).gap.min())
            / float(p.normal @ p.velocity)
            for p in moving
        )
    return travel
