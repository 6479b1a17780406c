"""Equilibrium of one mesh at one load stage, including friction and follower pressure."""

from dataclasses import replace

import numpy as np

from palpate.workers.mechanics.fem.elements.states import Stage, State
from palpate.workers.mechanics.fem.equilibrium.coupled_newton import MAX_ITERATIONS, solve_coupled
from palpate.workers.mechanics.fem.equilibrium.equilibrium_check import equilibrium_fault
from palpate.workers.mechanics.fem.equilibrium.newton import LOOSEST, Result, minimise
from palpate.workers.mechanics.fem.linear.level import Level, without_laws
from palpate.workers.mechanics.fem.linear.multigrid import LinearSolverFactory

# Updates of friction and follower pressure before giving up.
MAX_UPDATES = 40
# Accuracy of states that an update will change anyway: the first one, and later ones as a
# fraction of the last update's displacement.
FIRST_TOLERANCE_MM = 0.2
PART_OF_LAST_MOTION = 0.1
# A state with short steps but unbalanced forces is solved further, to a tolerance smaller by
# this factor, up to so many times.
TIGHTER, MAX_TIGHTENINGS = 0.1, 2


def solve_level(
    level: Level,
    start: State,
    stage: Stage,
    factory: LinearSolverFactory,
    tolerance_mm: float,
    max_iterations: int | None = None,
    forcing: float = LOOSEST,
) -> Result:
    """Find the equilibrium near `start`, with forces without an energy up to date.

    Friction is solved for together with the displacements. Where that does not converge, and for
    follower pressure alone, such forces are held while the energy is minimised, then updated.
    For `forcing` see `minimise`.
    """
    if level.constants.laws and not np.isfinite(level.energy(start, stage).potential):
        # The law is undefined for inverted elements; a neo-Hookean body finds a start without any.
        neo_hookean = replace(without_laws(level.problem), restarts=False)
        relaxed = Level.build(level.model, neo_hookean)
        relaxed = relaxed if level.barrier is None else relaxed.with_barrier()
        found = minimise(relaxed, start.with_eigenvector(None), stage, factory, tolerance_mm)
        start = start.moved_to(found.state.x, found.state.travel_mm)
    if level.is_conservative(start):
        return minimise(level, start, stage, factory, tolerance_mm, max_iterations, forcing)
    if start.history.friction:
        coupled = _solve_together(level, start, stage, factory, tolerance_mm, max_iterations)
        if not coupled.reason:
            return coupled
    return _solve_by_updates(level, start, stage, factory, tolerance_mm, max_iterations, forcing)


def _solve_together(
    level: Level,
    start: State,
    stage: Stage,
    factory: LinearSolverFactory,
    tolerance_mm: float,
    max_iterations: int | None,
) -> Result:
    """Solve for displacements and friction at once.

    The coarsest mesh, whose start is far off, is first solved with the initial friction held.
    """
    limit = min(MAX_ITERATIONS, max_iterations or MAX_ITERATIONS)
    if level.model.transfer is not None:
        return solve_coupled(level, start, stage, factory, tolerance_mm, limit)
    near = minimise(level, start, stage, factory, max(FIRST_TOLERANCE_MM, tolerance_mm))
    if near.reason:
        return near
    found = solve_coupled(level, near.state, stage, factory, tolerance_mm, limit)
    newton, cg = near.iterations + found.iterations, near.cg_iterations + found.cg_iterations
    return replace(found, iterations=newton, cg_iterations=cg)


def _solve_by_updates(
    level: Level,
    start: State,
    stage: Stage,
    factory: LinearSolverFactory,
    tolerance_mm: float,
    max_iterations: int | None,
    forcing: float,
) -> Result:
    """Alternate between minimising the energy and updating friction and follower pressure.

    Ends when an update moves no node by more than `tolerance_mm`.
    """
    near = max(FIRST_TOLERANCE_MM, tolerance_mm)
    result = minimise(level, start, stage, factory, near, max_iterations, forcing)
    newton, cg = result.iterations, result.cg_iterations
    moved = np.inf
    for _ in range(MAX_UPDATES):
        if result.reason:
            return result
        updated = level.update_history(result.state, stage)
        again = minimise(level, updated, stage, factory, near)
        moved = float(np.abs(again.state.x - result.state.x).max())
        newton, cg = newton + again.iterations, cg + again.cg_iterations
        result = replace(again, iterations=newton, cg_iterations=cg)
        if moved < tolerance_mm and near <= tolerance_mm:
            return result
        near = max(tolerance_mm, PART_OF_LAST_MOTION * moved)
    reason = f"friction or pressure still moved the body by {moved:.2g} mm"
    return Result(result.state, reason, newton, cg, result.residual_n, result.linear)


def solve_balanced(
    level: Level,
    start: State,
    stage: Stage,
    factory: LinearSolverFactory,
    tolerance_mm: float,
    max_iterations: int | None = None,
    forcing: float = LOOSEST,
) -> Result:
    """Find the equilibrium near `start` on the finest mesh, with balanced forces.

    `solve_level` ends when steps are short. In a slender or stiff body with a good start they are
    short at once, although forces need not be balanced; it is then solved more accurately.
    """
    result = solve_level(level, start, stage, factory, tolerance_mm, max_iterations, forcing)
    for _ in range(MAX_TIGHTENINGS):
        if result.reason or not _fault(level, result.state, stage):
            break
        tolerance_mm *= TIGHTER
        again = solve_level(level, result.state, stage, factory, tolerance_mm, max_iterations)
        newton = result.iterations + again.iterations
        cg = result.cg_iterations + again.cg_iterations
        result = replace(again, iterations=newton, cg_iterations=cg)
    return result


def _fault(level: Level, state: State, stage: Stage) -> str:
    """Return the reason why the forces on a level are not balanced; empty if they are."""
    at = level.energy(state, stage)
    return equilibrium_fault(level, state, at, stage, level.force(state, at, stage))
