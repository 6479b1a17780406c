"""From constants and loads to a displacement: nested iteration, coarse to fine.

The body is solved from rest on the coarsest mesh; each finer one starts from the
coarser solution and takes a few Newton steps, whose linear systems the coarser
levels precondition. Friction depends on the path: the load is then applied in
steps, and every step ends in equilibrium on every mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.fem.level import Level, Stage, State, Tangent, without_laws
from workers.fem.model import Model
from workers.fem.multigrid import Factored, LinearSolver, Multigrid
from workers.fem.newton import LinearSolverFactory, Result, minimise
from workers.fem.outcome import Solution
from workers.fem.problem import Problem
from workers.fem.report import report
from workers.fem.rest import stress_free
from workers.fem.steps import in_contact, ramps, stage_at, stages_of

# Coarse levels only supply a start: their own error is far larger than this.
COARSE_TOLERANCE_MM = 0.05
# Renewals of friction and follower pressure before giving up.
MAX_RENEWALS = 40


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The levels of a body at the end of its loading, coarse to fine.

    Parameters
    ----------
    imaged, model : Model
        As imaged, and with the stress-free shape where that is another one.
    problem : Problem
    stage : Stage
    levels : tuple of Level
    states : tuple of State
    solvers : tuple of LinearSolver
        One for each level, at its last tangent.
    solution : Solution
    """

    imaged: Model
    model: Model
    problem: Problem
    stage: Stage
    levels: tuple[Level, ...]
    states: tuple[State, ...]
    solvers: tuple[LinearSolver, ...]
    solution: Solution


def solve(model: Model, problem: Problem) -> Solution:
    """Load the body.

    Parameters
    ----------
    model : Model
        The prepared mesh hierarchy; its finest level carries the answer.
    problem : Problem
        Constants, loads and boundary conditions.

    Returns
    -------
    Solution
        Displacement of the finest nodes in mm and the outcome. A simulation that
        does not converge is an outcome, not an error; its displacement is the
        last state reached, carried to the finest mesh.

    Raises
    ------
    InputError
        If a tissue of the mesh has no constants.
    """
    return equilibrium(model, problem).solution


def equilibrium(model: Model, problem: Problem, start: Equilibrium | None = None) -> Equilibrium:
    """Load the body and keep what the solver knows at the end.

    Parameters
    ----------
    model, problem : Model and Problem
        See `solve`.
    start : Equilibrium, optional
        Of a similar problem on the same model. Newton's method then starts from it
        on the finest mesh; where that fails, or with friction or pressure, the body
        is solved from rest.

    Raises
    ------
    InputError
        If a tissue of the mesh has no constants.
    """
    imaged = model
    if any(problem.imaged_gravity_g):
        model = stress_free(model, problem, equilibrium)
    levels = [Level(m, problem) for m in model]
    march = _March(model, problem, levels)
    by_path = bool(problem.load.device.friction) or bool(problem.pressures)
    if start is None or by_path or not march.continue_from(start):
        march.from_rest()
    solution = report(levels[-1], imaged.finest, march.stage, march.states[-1], march.results)
    return Equilibrium(
        imaged,
        model,
        problem,
        march.stage,
        tuple(levels),
        tuple(march.states),
        tuple(march.solvers),
        solution,
    )


class _March:
    """The way of all levels through the stages of a load."""

    def __init__(self, model: Model, problem: Problem, levels: list[Level]) -> None:
        self.model, self.problem, self.levels = model, problem, levels
        self.stages = stages_of(model, problem)
        self.stage = self.stages[-1]
        self.states = [State(level.model.nodes.copy(), 0.0) for level in levels]
        self.solvers: list[LinearSolver] = []
        self.results: list[Result] = []

    def continue_from(self, start: Equilibrium) -> bool:
        """One Newton iteration from a neighbour's solution; False if it did not converge."""
        if start.solution.outcome.reason or len(start.states) != len(self.levels):
            return False
        level, near = self.levels[-1], start.states[-1]
        state = State(level.placed(near.x, self.stage.fraction), near.travel_mm)
        factory = _factory(start.solvers[:-1])
        result = minimise(
            level,
            in_contact(level, state, self.stage),
            self.stage,
            factory,
            self.problem.tolerance_mm,
            max_iterations=12,
        )
        if result.reason or result.linear is None:
            return False
        self.states = [*start.states[:-1], result.state]
        self.solvers = [*start.solvers[:-1], result.linear]
        self.results = [result]
        return True

    def from_rest(self) -> None:
        """All stages, each from coarse to fine."""
        for number, stage in enumerate(self.stages):
            self.stage = stage
            if not self._settle_all(stage, first=number == 0):
                return

    def _settle_all(self, stage: Stage, *, first: bool) -> bool:
        before = list(self.states)
        self.results, self.solvers = [], []
        for k, level in enumerate(self.levels):
            level.begin_step(before[k], stage)
            tolerance = self._tolerance(k)
            if k == 0 and first:
                result = self._coarsest_from_rest(tolerance)
            else:
                start = self._start(k, before, stage, first=first)
                result = _settle(level, start, stage, _factory(self.solvers), tolerance)
            self.results.append(result)
            self.states[k] = result.state
            if result.reason or result.linear is None:
                self._carry_on(k)
                return False
            self.solvers.append(result.linear)
        return True

    def _tolerance(self, k: int) -> float:
        if k == len(self.levels) - 1:
            return self.problem.tolerance_mm
        return max(COARSE_TOLERANCE_MM, self.problem.tolerance_mm)

    def _start(self, k: int, before: Sequence[State], stage: Stage, *, first: bool) -> State:
        """The coarser solution, or what it gained since the stage before on top of that."""
        level = self.levels[k]
        if k == 0:
            placed = level.placed(before[0].x, stage.fraction)
            return in_contact(level, State(placed, before[0].travel_mm), stage)
        coarse = self.states[k - 1]
        if first:
            start = self._prolonged(k, coarse.x - self.levels[k - 1].model.nodes)
            travel = coarse.travel_mm
        else:
            start = before[k].x - level.model.nodes
            start = start + self._prolonged(k, coarse.x - before[k - 1].x)
            travel = before[k].travel_mm + coarse.travel_mm - before[k - 1].travel_mm
        x = level.placed(level.model.nodes + start, stage.fraction)
        return in_contact(level, State(x, travel), stage)

    def _prolonged(self, k: int, u: FloatArray) -> FloatArray:
        transfer = self.levels[k].model.transfer
        if transfer is None:
            raise AssertionError("only the coarsest level has no transfer")
        return np.asarray(transfer.exact @ u)

    def _coarsest_from_rest(self, tolerance_mm: float) -> Result:
        """In more and more steps of the load, until one way succeeds."""
        level, result = self.levels[0], None
        for steps in ramps(self.problem.load):
            state = State(level.model.nodes.copy(), 0.0)
            for i in range(steps):
                fraction = self.stage.fraction * (i + 1) / steps
                stage = stage_at(self.model, self.problem.load, fraction)
                state = State(level.placed(state.x, stage.fraction), state.travel_mm)
                state = in_contact(level, state, stage)
                result = _settle(level, state, stage, _factory(()), tolerance_mm)
                if result.reason:
                    break
                state = result.state
            if result is not None and not result.reason:
                break
        if result is None:
            raise AssertionError("a load has at least one step")
        return result

    def _carry_on(self, k: int) -> None:
        """Carry a state that did not converge to the finest mesh, to be looked at."""
        for fine in range(k + 1, len(self.levels)):
            u = self._prolonged(fine, self.states[fine - 1].x - self.levels[fine - 1].model.nodes)
            level = self.levels[fine]
            x = level.placed(level.model.nodes + u, self.stage.fraction)
            self.states[fine] = State(x, self.states[fine - 1].travel_mm)


def linear_solver(level: Level, tangent: Tangent, coarser: Sequence[LinearSolver]) -> LinearSolver:
    """A solver with this tangent, preconditioned by those of the coarser levels."""
    return Multigrid(level, tangent, coarser[-1]) if coarser else Factored(level, tangent)


def _factory(coarser: Sequence[LinearSolver]) -> LinearSolverFactory:
    below = tuple(coarser)
    return lambda level, tangent: linear_solver(level, tangent, below)


def _settle(
    level: Level, start: State, stage: Stage, factory: LinearSolverFactory, tolerance_mm: float
) -> Result:
    """Equilibrium with whatever has no energy brought up to date."""
    if level.laws and not np.isfinite(level.energy(start, stage).potential):
        # The law knows no inverted element; a neo-Hookean body finds a start without any.
        relaxed = Level(level.model, without_laws(level.problem))
        relaxed.grips, relaxed.follower = level.grips, level.follower
        start = minimise(relaxed, start, stage, factory, tolerance_mm).state
    result = minimise(level, start, stage, factory, tolerance_mm)
    if not level.lags:
        return result
    newton, cg = result.iterations, result.cg_iterations
    for _ in range(MAX_RENEWALS):
        if result.reason:
            return result
        level.renew(result.state, stage)
        again = minimise(level, result.state, stage, factory, tolerance_mm)
        moved = float(np.abs(again.state.x - result.state.x).max())
        newton, cg = newton + again.iterations, cg + again.cg_iterations
        result = Result(again.state, again.reason, newton, cg, again.residual_n, again.linear)
        if moved < tolerance_mm:
            return result
    reason = f"friction or pressure still moved the body by {moved:.2g} mm"
    return Result(result.state, reason, newton, cg, result.residual_n, result.linear)
