"""From constants and plates to a displacement: nested iteration, coarse to fine.

The coarsest mesh is solved from rest; each finer one starts from the coarser
solution and takes a few Newton steps, whose linear systems the coarser levels
precondition. There is no load stepping, unless the coarsest mesh needs it.
"""

from collections.abc import Sequence

from workers.fem import kernels
from workers.fem.contact import Gap
from workers.fem.level import Level, State, Tangent
from workers.fem.model import Model
from workers.fem.multigrid import Factored, LinearSolver, Multigrid
from workers.fem.newton import LinearSolverFactory, Press, Result, minimise
from workers.fem.outcome import SQUEEZED_J, Outcome, Solution
from workers.fem.problem import DistanceControl, ForceControl, Load, Problem

# Coarse levels only supply a start: their own error is far larger than this.
COARSE_TOLERANCE_MM = 0.05
# The plates begin a little inside the body: without contact nothing resists.
OVERLAP_MM = 0.5
RAMPS = (1, 4, 12)


def solve(model: Model, problem: Problem) -> Solution:
    """Compress the body.

    Parameters
    ----------
    model : Model
        The prepared mesh hierarchy; its finest level carries the answer.
    problem : Problem
        Constants, plates and boundary conditions.

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
    levels = [Level(m, problem) for m in model]
    results: list[Result] = []
    solvers: list[LinearSolver] = []
    state = State(levels[0].model.nodes.copy(), 0.0)
    for k, level in enumerate(levels):
        last = k == len(levels) - 1
        tolerance = problem.tolerance_mm if last else COARSE_TOLERANCE_MM
        factory = _factory(solvers)
        if k == 0:
            result = _from_rest(level, problem.load, factory, tolerance)
        else:
            start = _prolong(levels[k - 1], level, state)
            result = minimise(
                level,
                _in_contact(level, start, problem.load),
                _press(problem.load),
                factory,
                tolerance,
            )
        results.append(result)
        state = result.state
        if result.reason:
            break
        if result.linear is not None:
            solvers.append(result.linear)
    for coarse, fine in zip(levels[len(results) - 1 :], levels[len(results) :], strict=False):
        state = _prolong(coarse, fine, state)
    return _report(levels[-1], problem, state, results)


def _factory(coarser: Sequence[LinearSolver]) -> LinearSolverFactory:
    if not coarser:
        return Factored
    below = coarser[-1]

    def multigrid(level: Level, tangent: Tangent) -> LinearSolver:
        return Multigrid(level, tangent, below)

    return multigrid


def _press(load: Load) -> Press:
    gap = Gap(load.lower_mm, load.upper_mm)
    return Press(gap, load.force_n if isinstance(load, ForceControl) else None)


def _from_rest(
    level: Level, load: Load, factory: LinearSolverFactory, tolerance_mm: float
) -> Result:
    """Solve on the coarsest mesh, in more and more steps of the load until one way succeeds."""
    result: Result | None = None
    for steps in _ramps(load):
        state = _in_contact(level, State(level.model.nodes.copy(), 0.0), load)
        for press in _ramp(level, load, steps):
            result = minimise(level, state, press, factory, tolerance_mm)
            if result.reason:
                break
            state = result.state
        else:
            break
    if result is None:
        raise AssertionError("a load has at least one step")
    return result


def _ramps(load: Load) -> tuple[int, ...]:
    return RAMPS if isinstance(load, ForceControl) else (8, 24)


def _ramp(level: Level, load: Load, steps: int) -> list[Press]:
    goal = _press(load)
    fractions = [(i + 1) / steps for i in range(steps)]
    if goal.force_n is not None:
        return [Press(goal.gap, f * goal.force_n) for f in fractions]
    open_gap = _starting_gap(level)
    return [Press(open_gap.towards(goal.gap, f)) for f in fractions]


def _in_contact(level: Level, state: State, load: Load) -> State:
    """Let a force-controlled plate begin where it touches the body."""
    if isinstance(load, DistanceControl):
        return state
    top = float(state.x[level.model.pads.nodes, 1].max())
    # From rest the plate begins well inside; a prolonged state may only just miss it.
    overlap_mm = OVERLAP_MM if state.travel_mm == 0.0 else 0.02
    return State(state.x, max(state.travel_mm, load.upper_mm - top + overlap_mm))


def _prolong(coarse: Level, fine: Level, state: State) -> State:
    transfer = fine.model.transfer
    if transfer is None:
        raise AssertionError("only the coarsest level has no transfer")
    u = transfer.exact @ (state.x - coarse.model.nodes)
    return State(fine.model.nodes + u * fine.free, state.travel_mm)


def _report(finest: Level, problem: Problem, state: State, results: Sequence[Result]) -> Solution:
    model = finest.model
    gap = _press(problem.load).at(state.travel_mm)
    at = finest.energy(state.x, gap)
    upper, lower = at.touch.upper_force, at.touch.lower_force
    min_j = kernels.smallest_volume_ratio(state.x, model.tets, model.gradients)
    reason = results[-1].reason
    start = _starting_gap(finest)
    travel = (
        state.travel_mm
        if isinstance(problem.load, ForceControl)
        else (start.upper_mm - start.lower_mm) - (gap.upper_mm - gap.lower_mm)
    )
    pressed = at.touch.upper > 0
    area = model.pads.stiffness[pressed].sum() / model.pads.stiffness.sum() * model.sheet.area.sum()
    return Solution(
        displacement_mm=state.x - model.nodes,
        outcome=Outcome(
            converged=not reason,
            reason=reason,
            newton_iterations=tuple(r.iterations for r in results),
            cg_iterations=tuple(r.cg_iterations for r in results),
            residual_n=results[-1].residual_n,
            plate_displacement_mm=float(travel),
            plate_force_n=upper,
            contact_area_mm2=float(area),
            penetration_mm=float(max(at.touch.upper.max(), at.touch.lower.max())),
            min_j=float(min_j),
            energy_mj=at.stored,
            force_imbalance=abs(upper - lower) / max(upper, 1e-12),
            wall_force_n=finest.wall_reaction(state.x, gap),
            squeezed=not reason and min_j < SQUEEZED_J,
        ),
    )


def _starting_gap(level: Level) -> Gap:
    y = level.model.nodes[:, 1]
    return Gap(float(y.min()), float(y.max()))
