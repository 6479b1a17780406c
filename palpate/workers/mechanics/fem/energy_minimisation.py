"""Newton's method with an energy line search on one level.

The travel of force-controlled plates is one more unknown; it appears linearly in
the bordered system and is eliminated exactly.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.discretisation import Stage, State
from palpate.workers.mechanics.fem.element_energy import smallest_volume_ratio
from palpate.workers.mechanics.fem.element_laws import J_BARRIER
from palpate.workers.mechanics.fem.krylov_solvers import Correction
from palpate.workers.mechanics.fem.mesh_level import Energy, Level, Tangent
from palpate.workers.mechanics.fem.multigrid import LinearSolver, LinearSolverFactory

MAX_ITERATIONS = 60
# Iterations with a barrier against collapse. After the usual number, step lengths are chosen
# more carefully, and a tangent that is not positive is made so.
MAX_ITERATIONS_WITH_BARRIER, USUAL_ITERATIONS = 160, 25
# A body collapses if an element has lost half of its volume and the residual has not fallen for
# so many iterations, none of which lowered the energy by more than this fraction: far from
# equilibrium residuals rise in ordinary solves too.
STALLED_ITERATIONS, SMALL_FALL = 8, 1e-3
MAX_HALVINGS = 14
# Longest step of a node in one iteration; beyond it the quadratic model is invalid.
LONGEST_STEP_MM = 20.0
# Conjugate gradients: loose first, tighter as the residual falls (Eisenstat-Walker).
LOOSEST, TIGHTEST = 3e-2, 1e-3
# Length of a step along a direction of negative curvature: the first one, and the shortest.
FIRST_REACH_MM, SHORTEST_REACH_MM = 1.0, 0.05
# With an exact tangent a step gains half of its slope. A step that gains more than the second of
# these fractions is doubled (out of a saddle), less than the first halved (before fibres go taut).
ORDINARY_GAIN = 0.3, 0.8


@dataclass(frozen=True, eq=False)
class Result:
    """End of Newton's method.

    Parameters
    ----------
    state : State
    reason : str
        Reason why it did not converge; empty if it did.
    iterations, cg_iterations : int
    residual_n : float
        Norm of the last out-of-balance force.
    linear : LinearSolver or None
        With the last tangent.
    collapses : bool
        Ended early because elements collapse; `state` then has the smallest residual.
    """

    state: State
    reason: str
    iterations: int
    cg_iterations: int
    residual_n: float
    linear: LinearSolver | None
    collapses: bool = False


@dataclass(frozen=True, eq=False)
class _LeastResidual:
    """State with the smallest residual so far, and the number of iterations since then.

    The count restarts whenever the potential, now `last_potential`, falls substantially.
    """

    residual_n: float
    state: State
    iterations_ago: int
    last_potential: float

    def followed_by(self, residual_n: float, state: State, potential: float) -> "_LeastResidual":
        """Return the record after another iteration, at a state with this residual."""
        fell = self.last_potential - potential > SMALL_FALL * abs(potential)
        if fell or residual_n < self.residual_n:
            return _LeastResidual(residual_n, state, 0, potential)
        return replace(self, iterations_ago=self.iterations_ago + 1, last_potential=potential)


@dataclass(frozen=True, eq=False)
class _Step:
    """Newton direction, its slope and its largest nodal displacement."""

    u: FloatArray
    travel: float
    slope: float
    longest: float
    cg_iterations: int
    negative: bool
    curved: FloatArray | None = None


def minimise(
    level: Level,
    start: State,
    stage: Stage,
    factory: LinearSolverFactory,
    tolerance_mm: float,
    max_iterations: int | None = None,
    forcing: float = LOOSEST,
) -> Result:
    """Find the equilibrium nearest to `start`.

    Friction and follower pressure are held. Converged when a full step moves no node by
    more than `tolerance_mm`. The default of `max_iterations` depends on the barrier. The first
    step is solved to a relative residual of `forcing`: `TIGHTEST` for a start so close that this
    step may be the last. If a body collapses and may be solved again with a barrier, the result is
    the state with the smallest residual.
    """
    if max_iterations is None:
        guarded = level.barrier is not None
        max_iterations = MAX_ITERATIONS_WITH_BARRIER if guarded else MAX_ITERATIONS
    state = start
    energy = level.energy(state, stage)
    cg_total, residual, last_residual = 0, np.inf, np.inf
    least = _LeastResidual(np.inf, start, 0, np.inf)
    linear: LinearSolver | None = None
    # `convex` stays set: no descent otherwise; `cautious` holds for this step only.
    convex = cautious = False
    reach = FIRST_REACH_MM
    for iteration in range(1, max_iterations + 1):
        late = level.barrier is not None and iteration > USUAL_ITERATIONS
        held = convex or cautious
        force, tangent = level.linearise(state, energy, stage, convex=held, positive=held and late)
        if stage.force_n is not None and tangent.plate_stiffness == 0:
            return Result(state, "the plate lost contact", iteration, cg_total, residual, linear)
        plate = plate_residual(energy, stage)
        residual = float(np.sqrt(np.vdot(force, force) + plate**2))
        if np.isfinite(last_residual):
            forcing = min(LOOSEST, max(TIGHTEST, 0.5 * (residual / last_residual) ** 1.5))
        last_residual = residual
        least = least.followed_by(residual, state, energy.potential)
        if least.iterations_ago >= STALLED_ITERATIONS and _collapses(level, state):
            reason = f"elements collapse at a residual of {residual:.3g} N"
            return Result(least.state, reason, iteration, cg_total, residual, linear, True)
        linear = factory(level, tangent, state.history.eigenvector)
        state = state.with_eigenvector(linear.eigenvector)
        step = _direction(force, plate, tangent, linear, forcing)
        cg_total += step.cg_iterations
        indefinite = False
        downhill = level.barrier is not None and step.curved is not None
        if downhill:
            step = _along_curvature(step, tangent, force, plate, reach)
        elif step.negative and not held:
            indefinite = True
            # Far from equilibrium pressure may make the tangent indefinite: leave it out.
            _, tangent = level.linearise(state, energy, stage, convex=True, positive=late)
            linear = factory(level, tangent, state.history.eigenvector)
            state = state.with_eigenvector(linear.eigenvector)
            step = _direction(force, plate, tangent, linear, forcing)
            cg_total += step.cg_iterations
        refine = late or downhill
        state, energy, length = _line_search(level, state, energy, stage, step, refine=refine)
        if downhill and length > 0:
            reach = min(LONGEST_STEP_MM, max(SHORTEST_REACH_MM, length * step.longest))
        cautious = (indefinite or cautious) and (step.negative or length < 1) and length > 0
        gap = stage.gap_at(state.travel_mm)
        if gap is not None and gap.upper_mm <= gap.lower_mm:
            return Result(state, "the plates met", iteration, cg_total, residual, linear)
        if length == 0:
            if convex:
                reason = f"no descent at a residual of {residual:.3g} N"
                return Result(state, reason, iteration, cg_total, residual, linear)
            convex = True
        elif length == 1 and step.longest < tolerance_mm and not downhill:
            return Result(state, "", iteration, cg_total, residual, linear)
    reason = f"{max_iterations} Newton iterations left a residual of {residual:.3g} N"
    return Result(state, reason, max_iterations, cg_total, residual, linear)


def _collapses(level: Level, state: State) -> bool:
    """Test whether a barrier would act at this state, and may be tried.

    The coarsest level, where failures are cheap, tries smaller increments first.
    """
    if level.barrier is not None or level.model.transfer is None or not level.problem.restarts:
        return False
    return bool(smallest_volume_ratio(state.x, level.model.elements) < J_BARRIER)


def solve_bordered(
    linear: LinearSolver, tangent: Tangent, force: FloatArray, plate: float, tolerance: float
) -> tuple[Correction, float]:
    """Solve for displacement and travel under nodal forces, (n, 3) in N, and a plate force."""
    if tangent.plate_stiffness == 0:
        return linear.solve(force, tolerance), 0.0
    b = force.copy()
    b[tangent.contact_index] -= tangent.coupling * (plate / tangent.plate_stiffness)
    correction = linear.solve(b, tolerance)
    along = float(np.vdot(tangent.coupling, correction.u[tangent.contact_index]))
    return correction, (plate - along) / tangent.plate_stiffness


def plate_residual(energy: Energy, stage: Stage) -> float:
    """Return the out-of-balance force on force-controlled plates, in N."""
    return 0.0 if stage.force_n is None else energy.contact.travel_force - stage.force_n


def _direction(
    force: FloatArray, plate: float, tangent: Tangent, linear: LinearSolver, forcing: float
) -> _Step:
    """Return the Newton direction, reversed if it points uphill."""
    correction, travel = solve_bordered(linear, tangent, -force, -plate, forcing)
    u = correction.u
    slope = float(np.vdot(force, u)) + plate * travel
    if slope > 0:
        u, travel, slope = -u, -travel, -slope
    longest = float(np.abs(u).max())
    return _Step(
        u, travel, slope, longest, correction.iterations, correction.negative, correction.curved
    )


def _along_curvature(
    step: _Step, tangent: Tangent, force: FloatArray, plate: float, reach_mm: float
) -> _Step:
    """Extend a step along a direction of negative curvature, up to `reach_mm`.

    T. Steihaug, SIAM J. Numer. Anal. 20 (1983) 626: where the energy is not convex, conjugate
    gradients end at the boundary of the trust region.
    """
    p = step.curved
    if p is None:
        raise AssertionError("there is a direction of negative curvature")
    along = float(np.vdot(tangent.coupling, p[tangent.contact_index]))
    travel = -along / tangent.plate_stiffness if tangent.plate_stiffness else 0.0
    before = 0.0 if step.u is p else 1.0
    far = max(0.0, reach_mm - before * step.longest) / float(np.abs(p).max())
    u, move = before * step.u + far * p, before * step.travel + far * travel
    slope = float(np.vdot(force, u)) + plate * move
    return replace(step, u=u, travel=move, slope=slope, longest=float(np.abs(u).max()))


def _line_search(
    level: Level, state: State, energy: Energy, stage: Stage, step: _Step, *, refine: bool
) -> tuple[State, Energy, float]:
    """Backtrack until the potential falls; a length of 0 means failure.

    With `refine`, a length with an unusually large or small gain is doubled or halved as long
    as the potential falls further.
    """
    length = min(1.0, LONGEST_STEP_MM / step.longest) if step.longest > 0 else 1.0
    # Near the minimum the decrease is below rounding; a Newton step is then accepted unchecked.
    noise = 1e-11 * (abs(energy.elastic) + abs(energy.potential - energy.elastic))
    noise += level.rounding_mj
    for _ in range(MAX_HALVINGS):
        trial, trial_energy = _moved(level, state, stage, step, length)
        fall = trial_energy.potential - energy.potential
        if fall <= 1e-4 * length * step.slope or (-length * step.slope <= noise and fall <= noise):
            break
        length /= 2
    else:
        return state, energy, 0.0
    gain = fall / (length * step.slope) if refine and -fall > noise else ORDINARY_GAIN[0]
    if ORDINARY_GAIN[0] <= gain <= ORDINARY_GAIN[1]:
        return trial, trial_energy, length
    factor = 2.0 if gain > ORDINARY_GAIN[1] else 0.5
    while factor * length * step.longest <= LONGEST_STEP_MM:
        other, other_energy = _moved(level, state, stage, step, factor * length)
        if not other_energy.potential < trial_energy.potential:
            break
        trial, trial_energy, length = other, other_energy, factor * length
    return trial, trial_energy, length


def _moved(
    level: Level, state: State, stage: Stage, step: _Step, length: float
) -> tuple[State, Energy]:
    """Return the state after a step of relative `length`, and its energy."""
    there = state.moved_to(state.x + length * step.u, state.travel_mm + length * step.travel)
    return there, level.energy(there, stage)
