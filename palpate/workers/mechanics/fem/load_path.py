"""Load stepping of all meshes of a body, from coarse to fine.

A schedule has the stages of a load and the starting positions of force-controlled plates; at each
stage every mesh reaches equilibrium.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem import element_energy
from palpate.workers.mechanics.fem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.discretisation import History, Model, Stage, State
from palpate.workers.mechanics.fem.element_laws import J_BARRIER
from palpate.workers.mechanics.fem.energy_minimisation import (
    LOOSEST,
    MAX_ITERATIONS_WITH_BARRIER,
    TIGHTEST,
    Result,
)
from palpate.workers.mechanics.fem.level_equilibrium import solve_balanced, solve_level
from palpate.workers.mechanics.fem.loads_and_regions import (
    Device,
    DistanceControl,
    ForceControl,
    Load,
)
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.multigrid import LinearSolver, solver_factory
from palpate.workers.mechanics.fem.plate_contact import plate_contact
from palpate.workers.mechanics.fem.plate_surface import Gap, PlateSurface

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


# Coarse levels only supply a start: their discretisation error is far larger than this.
COARSE_TOLERANCE_MM = 0.05
# Newton iterations from a neighbour's state; if more are needed, the body is solved from rest.
# Points lose contact with the edge of a plate one by one, which takes up to 27 iterations; no
# other case needs more than 12. From rest such a load may need many stages.
MAX_ITERATIONS_FROM_NEIGHBOUR = 40


@dataclass(frozen=True, eq=False)
class ConvergedStage:
    """End of one stage: a state and a linear solver for each level, coarse to fine.

    `expected_mm`, shape (n, 3), is the expected displacement of the finest nodes from there when
    a similar problem is solved.
    """

    states: tuple[State, ...]
    solvers: tuple[LinearSolver, ...]
    expected_mm: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class LoadPath:
    """End of a path through the stages of a load.

    Parameters
    ----------
    stage : Stage
        The last stage attempted.
    states : tuple of State
        State of each level, coarse to fine; if the last stage did not converge, the state
        reached, prolonged to the finer levels.
    results : tuple of Result
        Result of each level solved in the last stage.
    converged : tuple of ConvergedStage
    levels : tuple of Level
        With a barrier if the body would collapse without one.
    """

    stage: Stage
    states: tuple[State, ...]
    results: tuple[Result, ...]
    converged: tuple[ConvergedStage, ...]
    levels: tuple[Level, ...]

    @property
    def reason(self) -> str:
        """Reason why the last stage did not converge; empty if it did."""
        return self.results[-1].reason

    @property
    def collapsed(self) -> bool:
        """Whether it ended, without a barrier, with collapsed or inverted elements."""
        last = self.results[-1]
        reached = next(k for k, state in enumerate(self.states) if state is last.state)
        level = self.levels[reached]
        if level.barrier is not None:
            return False
        ratio = element_energy.smallest_volume_ratio(last.state.x, level.model.elements)
        return bool(last.collapses or ratio < (J_BARRIER if last.reason else 0.0))


@dataclass(frozen=True, eq=False)
class LoadStepping:
    """Levels of a body under one problem, coarse to fine, ready to be loaded."""

    model: Model
    problem: Problem
    levels: tuple[Level, ...]

    def run(self, neighbour: Sequence[ConvergedStage] | None = None) -> LoadPath:
        """Load the body, from a similar problem's stages if they lead to the full load.

        See `Problem.restarts`. A body that collapses is solved with a barrier.
        """
        path = self._run(neighbour)
        if not (path.collapsed and self.problem.restarts):
            return path
        guarded = self.with_barrier()
        resumed = guarded.resume(path)
        return guarded.from_rest([History() for _ in self.levels]) if resumed.reason else resumed

    def _run(self, neighbour: Sequence[ConvergedStage] | None) -> LoadPath:
        """Load the body with the present levels."""
        histories = tuple(History() for _ in self.levels)
        if neighbour is not None:
            path = self.continue_from(neighbour)
            if path is not None and not (path.reason and self.problem.restarts):
                return path
            if path is not None:
                histories = (*histories[:-1], path.states[-1].history)
        return self.from_rest(histories)

    def from_rest(self, histories: Sequence[History]) -> LoadPath:
        """Run all stages, with finer and finer schedules until one succeeds.

        Except for friction, each attempt starts with the histories of the previous one.
        """
        path: LoadPath | None = None
        for stages in load_schedules(self.model, self.problem):
            path = self._follow(stages, self._at_rest(histories))
            if not path.reason or self._is_exhausted_with_barrier(path):
                break
            if path.results[-1].collapses:
                break
            histories = [s.history for s in path.states]
        if path is None:
            raise AssertionError("a load has at least one schedule")
        return path

    def with_barrier(self) -> "LoadStepping":
        """Return the same levels with a barrier against the collapse of elements."""
        return replace(self, levels=tuple(level.with_barrier() for level in self.levels))

    def resume(self, path: LoadPath) -> LoadPath:
        """Continue a path at the level where it failed, from the state reached there.

        A load with several stages, or whose coarsest level failed, is restarted.
        """
        in_one_stage = path.stage.fraction == 1 and len(path.converged) <= 1
        if not in_one_stage or len(path.results) == 1:
            return self.from_rest([History() for _ in self.levels])
        before = self._at_rest([s.history for s in path.states])
        states, results = self._solve_stage(path.stage, before, first=True, done=path.results)
        solvers = tuple(r.linear for r in results if r.linear is not None and not r.reason)
        converged = (ConvergedStage(states, solvers),) if len(solvers) == len(self.levels) else ()
        return LoadPath(path.stage, states, results, converged, self.levels)

    def _is_exhausted_with_barrier(self, path: LoadPath) -> bool:
        """Test whether the full load has used up the iterations of the finest mesh.

        Without friction, more stages then hardly help, and cost as much again.
        """
        at_end = len(path.results) == len(self.levels) and path.stage.fraction == 1
        spent = path.results[-1].iterations >= MAX_ITERATIONS_WITH_BARRIER
        guarded = self.levels[-1].barrier is not None
        return guarded and at_end and spent and not self.problem.load.device.friction

    def continue_from(self, neighbour: Sequence[ConvergedStage]) -> LoadPath | None:
        """Run a similar problem's stages on the finest mesh only, starting from its states.

        Returns
        -------
        LoadPath or None
            None if this load has no schedule with that number of stages.
        """
        schedules = load_schedules(self.model, self.problem)
        stages = next((s for s in schedules if len(s) == len(neighbour)), None)
        if stages is None or len(neighbour[-1].states) != len(self.levels):
            return None
        level, tolerance = self.levels[-1], self._tolerance(len(self.levels) - 1)
        states = self._at_rest([History() for _ in self.levels])
        converged: list[ConvergedStage] = []
        for stage, near in zip(stages, neighbour, strict=True):
            begun, there = level.begin_step(states[-1], stage), near.states[-1]
            x = level.with_prescribed(there.x, stage.fraction)
            start = bring_into_contact(level, begun.moved_to(x, there.travel_mm), stage)
            forcing = LOOSEST
            if near.expected_mm is not None:
                start = better_start(level, start, stage, near.expected_mm)
                forcing = TIGHTEST
            start = level.update_history(start, stage)
            factory, limit = solver_factory(near.solvers[:-1]), MAX_ITERATIONS_FROM_NEIGHBOUR
            result = solve_balanced(level, start, stage, factory, tolerance, limit, forcing)
            if result.reason or result.linear is None:
                states = (*states[:-1], result.state)
                break
            states = (*near.states[:-1], result.state)
            converged.append(ConvergedStage(states, (*near.solvers[:-1], result.linear)))
        return LoadPath(stage, states, (result,), tuple(converged), self.levels)

    def _at_rest(self, histories: Sequence[History]) -> tuple[State, ...]:
        """Return undeformed states of all levels, without friction."""
        return tuple(
            State(level.model.nodes.copy(), 0.0, replace(history, friction=()))
            for level, history in zip(self.levels, histories, strict=True)
        )

    def _follow(self, stages: Sequence[Stage], states: tuple[State, ...]) -> LoadPath:
        """Run `stages`, each from coarse to fine, until one fails."""
        converged: list[ConvergedStage] = []
        for number, stage in enumerate(stages):
            states, results = self._solve_stage(stage, states, first=number == 0)
            solvers = tuple(r.linear for r in results if r.linear is not None and not r.reason)
            if len(solvers) < len(self.levels):
                break
            converged.append(ConvergedStage(states, solvers))
        return LoadPath(stage, states, results, tuple(converged), self.levels)

    def _solve_stage(
        self, stage: Stage, before: tuple[State, ...], *, first: bool, done: Sequence[Result] = ()
    ) -> tuple[tuple[State, ...], tuple[Result, ...]]:
        """Solve one stage on each level, from coarse to fine, until one fails.

        If results of some levels are `done`, it starts where the last of them ended.
        """
        results = list(done[:-1])
        states = [result.state for result in results]
        solvers = [result.linear for result in results if result.linear is not None]
        for k, level in enumerate(self.levels):
            if k < len(results):
                continue
            begun, tolerance = level.begin_step(before[k], stage), self._tolerance(k)
            solve = solve_balanced if k == len(self.levels) - 1 else solve_level
            if k == len(done) - 1:
                result = solve(level, done[k].state, stage, solver_factory(solvers), tolerance)
            elif k == 0 and first:
                result = self._coarsest_from_rest(begun, stage, tolerance)
            else:
                start = self._start(k, begun, before, states, stage, first=first)
                result = solve(level, start, stage, solver_factory(solvers), tolerance)
            results.append(result)
            states.append(result.state)
            if result.reason or result.linear is None:
                return self._prolonged_to_finest(states, before, stage), tuple(results)
            solvers.append(result.linear)
        return tuple(states), tuple(results)

    def _tolerance(self, k: int) -> float:
        """Return the tolerance of level `k` in mm."""
        wanted = self.problem.tolerance_mm
        return wanted if k == len(self.levels) - 1 else max(COARSE_TOLERANCE_MM, wanted)

    def _start(
        self,
        k: int,
        begun: State,
        before: Sequence[State],
        coarser: Sequence[State],
        stage: Stage,
        *,
        first: bool,
    ) -> State:
        """Return the initial state of level `k`, which has `begun` the stage.

        This is the coarser solution, or `begun` plus the change of the coarser solution since the
        stage `before`.
        """
        level = self.levels[k]
        if k == 0:
            x = level.with_prescribed(begun.x, stage.fraction)
            return bring_into_contact(level, begun.moved_to(x, begun.travel_mm), stage)
        coarse = coarser[k - 1]
        if first:
            u = self._prolonged(k, coarse.x - self.levels[k - 1].model.nodes)
            travel = coarse.travel_mm
        else:
            u = begun.x - level.model.nodes
            u = u + self._prolonged(k, coarse.x - before[k - 1].x)
            travel = begun.travel_mm + coarse.travel_mm - before[k - 1].travel_mm
        x = level.with_prescribed(level.model.nodes + u, stage.fraction)
        return bring_into_contact(level, begun.moved_to(x, travel), stage)

    def _prolonged(self, k: int, u: FloatArray) -> FloatArray:
        """Interpolate a displacement of level `k` - 1, (n, 3), to level `k`."""
        transfer = self.levels[k].model.transfer
        if transfer is None:
            raise AssertionError("only the coarsest level has no transfer")
        return np.asarray(transfer.exact @ u)

    def _coarsest_from_rest(self, begun: State, goal: Stage, tolerance_mm: float) -> Result:
        """Load the coarsest level in more and more increments, until one attempt succeeds."""
        level, history = self.levels[0], begun.history
        for count in coarsest_increments(self.problem.load):
            state = State(level.model.nodes.copy(), 0.0, history)
            for i in range(count):
                fraction = goal.fraction * (i + 1) / count
                stage = stage_at(self.model, self.problem.load, fraction)
                x = level.with_prescribed(state.x, stage.fraction)
                state = bring_into_contact(level, state.moved_to(x, state.travel_mm), stage)
                result = solve_level(level, state, stage, solver_factory(()), tolerance_mm)
                if result.reason:
                    break
                state = result.state
            if not result.reason:
                break
            history = result.state.history
        return result

    def _prolonged_to_finest(
        self, states: Sequence[State], before: Sequence[State], stage: Stage
    ) -> tuple[State, ...]:
        """Prolong the last, unconverged state to all finer levels."""
        prolonged = list(states)
        for k in range(len(states), len(self.levels)):
            level, coarse = self.levels[k], prolonged[-1]
            u = self._prolonged(k, coarse.x - self.levels[k - 1].model.nodes)
            x = level.with_prescribed(level.model.nodes + u, stage.fraction)
            prolonged.append(before[k].moved_to(x, coarse.travel_mm))
        return tuple(prolonged)
