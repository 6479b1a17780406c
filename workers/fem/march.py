"""The way of all meshes of a body through the stages of its loading."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.fem.level import Level, Stage, State
from workers.fem.model import Model
from workers.fem.multigrid import LinearSolver
from workers.fem.newton import Result
from workers.fem.problem import Problem
from workers.fem.settle import factory_of, settle
from workers.fem.steps import in_contact, ramps, routes, stage_at, stages_of

# Coarse levels only supply a start: their own error is far larger than this.
COARSE_TOLERANCE_MM = 0.05


@dataclass(frozen=True, eq=False)
class Waypoint:
    """The end of one stage: a state and a solver for each level, coarse to fine."""

    states: tuple[State, ...]
    solvers: tuple[LinearSolver, ...]


class March:
    """The way of all levels through the stages of a load."""

    def __init__(self, model: Model, problem: Problem, levels: Sequence[Level]) -> None:
        self.model, self.problem, self.levels = model, problem, levels
        self.stages = stages_of(model, problem)
        self._restart()

    def _restart(self) -> None:
        self.stage = self.stages[-1]
        self.states = [State(level.model.nodes.copy(), 0.0) for level in self.levels]
        self.solvers: list[LinearSolver] = []
        self.results: list[Result] = []
        self.path: list[Waypoint] = []
        for level in self.levels:
            level.grips = ()

    def from_rest(self) -> None:
        """All stages, each from coarse to fine; in more of them, until one way succeeds."""
        for stages in routes(self.model, self.problem):
            self.stages = stages
            self._restart()
            if all(self._settle_all(s, first=n == 0) for n, s in enumerate(stages)):
                return

    def continue_from(self, path: Sequence["Waypoint"]) -> bool:
        """A neighbour's stages on the finest mesh alone, from its own; False if one fails."""
        ways = routes(self.model, self.problem)
        stages = next((way for way in ways if len(way) == len(path)), None)
        if stages is None or len(path[-1].states) != len(self.levels):
            return False
        self.stages = stages
        level = self.levels[-1]
        state = self.states[-1]
        for stage, near in zip(self.stages, path, strict=True):
            self.stage = stage
            level.begin_step(state, stage)
            there = near.states[-1]
            start = State(level.placed(there.x, stage.fraction), there.travel_mm)
            start = in_contact(level, start, stage)
            level.renew(start, stage)
            tolerance = self._tolerance(len(self.levels) - 1)
            result = settle(level, start, stage, factory_of(near.solvers[:-1]), tolerance, 12)
            if result.reason or result.linear is None:
                self._restart()
                return False
            state = result.state
            self.states = [*near.states[:-1], state]
            self.solvers = [*near.solvers[:-1], result.linear]
            self.results = [result]
            self.path.append(Waypoint(tuple(self.states), tuple(self.solvers)))
        return True

    def _settle_all(self, stage: Stage, *, first: bool) -> bool:
        self.stage = stage
        before = list(self.states)
        self.results, self.solvers = [], []
        for k, level in enumerate(self.levels):
            level.begin_step(before[k], stage)
            tolerance = self._tolerance(k)
            if k == 0 and first:
                result = self._coarsest_from_rest(tolerance)
            else:
                start = self._start(k, before, stage, first=first)
                result = settle(level, start, stage, factory_of(self.solvers), tolerance)
            self.results.append(result)
            self.states[k] = result.state
            if result.reason or result.linear is None:
                self._carry_on(k)
                return False
            self.solvers.append(result.linear)
        self.path.append(Waypoint(tuple(self.states), tuple(self.solvers)))
        return True

    def _tolerance(self, k: int) -> float:
        asked = self.problem.tolerance_mm
        return asked if k == len(self.levels) - 1 else max(COARSE_TOLERANCE_MM, asked)

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
                result = settle(level, state, stage, factory_of(()), tolerance_mm)
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
