"""Equilibrium of one mesh at one moment, friction and follower pressure included."""

from collections.abc import Sequence

import numpy as np

from workers.fem.level import Level, Stage, State, Tangent, without_laws
from workers.fem.multigrid import Factored, LinearSolver, Multigrid
from workers.fem.newton import MAX_ITERATIONS, LinearSolverFactory, Result, minimise

# Renewals of friction and follower pressure before giving up.
MAX_RENEWALS = 40
# How exactly a state is found that a renewal will change anyway: the first one, and those
# after, as a part of what the last renewal moved.
FIRST_MM = 0.2
PART = 0.1


def linear_solver(level: Level, tangent: Tangent, coarser: Sequence[LinearSolver]) -> LinearSolver:
    """A solver with this tangent, preconditioned by those of the coarser levels."""
    return Multigrid(level, tangent, coarser[-1]) if coarser else Factored(level, tangent)


def factory_of(coarser: Sequence[LinearSolver]) -> LinearSolverFactory:
    """What makes the solvers of a level, from those of the coarser ones."""
    below = tuple(coarser)
    return lambda level, tangent: linear_solver(level, tangent, below)


def settle(
    level: Level,
    start: State,
    stage: Stage,
    factory: LinearSolverFactory,
    tolerance_mm: float,
    max_iterations: int = MAX_ITERATIONS,
) -> Result:
    """Equilibrium with whatever has no energy brought up to date."""
    if level.laws and not np.isfinite(level.energy(start, stage).potential):
        # The law knows no inverted element; a neo-Hookean body finds a start without any.
        relaxed = Level(level.model, without_laws(level.problem))
        relaxed.grips, relaxed.follower = level.grips, level.follower
        start = minimise(relaxed, start, stage, factory, tolerance_mm).state
    if not level.lags:
        return minimise(level, start, stage, factory, tolerance_mm, max_iterations)
    near = max(FIRST_MM, tolerance_mm)
    result = minimise(level, start, stage, factory, near, max_iterations)
    newton, cg = result.iterations, result.cg_iterations
    for _ in range(MAX_RENEWALS):
        if result.reason:
            return result
        level.renew(result.state, stage)
        again = minimise(level, result.state, stage, factory, near)
        moved = float(np.abs(again.state.x - result.state.x).max())
        newton, cg = newton + again.iterations, cg + again.cg_iterations
        result = Result(again.state, again.reason, newton, cg, again.residual_n, again.linear)
        if moved < tolerance_mm and near <= tolerance_mm:
            return result
        near = max(tolerance_mm, PART * moved)
    reason = f"friction or pressure still moved the body by {moved:.2g} mm"
    return Result(result.state, reason, newton, cg, result.residual_n, result.linear)
