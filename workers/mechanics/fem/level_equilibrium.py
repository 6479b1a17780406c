"""Equilibrium of one mesh at one moment, friction and follower pressure included."""

import numpy as np

from workers.mechanics.fem.level import Level, without_laws
from workers.mechanics.fem.multigrid import LinearSolverFactory
from workers.mechanics.fem.newton import MAX_ITERATIONS, Result, minimise
from workers.mechanics.fem.states import Stage, State

# Updates of friction and follower pressure before giving up.
MAX_UPDATES = 40
# How exactly a state is found that an update will change anyway: the first one, and those
# after, as a part of what the last update moved.
FIRST_TOLERANCE_MM = 0.2
PART_OF_LAST_MOTION = 0.1


def solve_level(
    level: Level,
    start: State,
    stage: Stage,
    factory: LinearSolverFactory,
    tolerance_mm: float,
    max_iterations: int = MAX_ITERATIONS,
) -> Result:
    """Find the equilibrium near `start`, forces without an energy brought up to date.

    Friction and follower pressure are held while the energy is minimised, then updated,
    until an update moves no node by more than `tolerance_mm`.
    """
    if level.constants.laws and not np.isfinite(level.energy(start, stage).potential):
        # The law knows no inverted element; a neo-Hookean body finds a start without any.
        relaxed = Level.build(level.model, without_laws(level.problem))
        found = minimise(relaxed, start.with_eigenvector(None), stage, factory, tolerance_mm)
        start = start.moved_to(found.state.x, found.state.travel_mm)
    if level.is_conservative(start):
        return minimise(level, start, stage, factory, tolerance_mm, max_iterations)
    near = max(FIRST_TOLERANCE_MM, tolerance_mm)
    result = minimise(level, start, stage, factory, near, max_iterations)
    newton, cg = result.iterations, result.cg_iterations
    moved = np.inf
    for _ in range(MAX_UPDATES):
        if result.reason:
            return result
        updated = level.update_history(result.state, stage)
        again = minimise(level, updated, stage, factory, near)
        moved = float(np.abs(again.state.x - result.state.x).max())
        newton, cg = newton + again.iterations, cg + again.cg_iterations
        result = Result(again.state, again.reason, newton, cg, again.residual_n, again.linear)
        if moved < tolerance_mm and near <= tolerance_mm:
            return result
        near = max(tolerance_mm, PART_OF_LAST_MOTION * moved)
    reason = f"friction or pressure still moved the body by {moved:.2g} mm"
    return Result(result.state, reason, newton, cg, result.residual_n, result.linear)
