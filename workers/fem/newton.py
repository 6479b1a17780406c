"""Newton's method with an energy line search on one level.

The travel of a force-controlled plate is one more unknown; it appears linearly
in the bordered system and is eliminated exactly.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.fem.contact import Gap
from workers.fem.level import Energy, Level, State, Tangent
from workers.fem.multigrid import LinearSolver

MAX_ITERATIONS = 60
MAX_HALVINGS = 14
# Longest step of a node in one iteration; farther, the quadratic model says nothing.
LONGEST_STEP_MM = 20.0
# Conjugate gradients: loose first, tighter as the residual falls (Eisenstat-Walker).
LOOSEST, TIGHTEST = 3e-2, 1e-3

LinearSolverFactory = Callable[[Level, Tangent], LinearSolver]


@dataclass(frozen=True, slots=True)
class Press:
    """What the plates do: where they stand at zero travel, and the force to reach.

    Without a force the plates stay where `gap` says.
    """

    gap: Gap
    force_n: float | None = None

    def at(self, travel_mm: float) -> Gap:
        """Where the plates stand after `travel_mm`."""
        return self.gap if self.force_n is None else self.gap.closed_by(travel_mm)

    def work(self, travel_mm: float) -> float:
        """Work of the prescribed force in mJ."""
        return 0.0 if self.force_n is None else self.force_n * travel_mm


@dataclass(frozen=True, eq=False)
class Result:
    """Where Newton's method ended; `reason` is empty when it converged."""

    state: State
    reason: str
    iterations: int
    cg_iterations: int
    residual_n: float
    linear: LinearSolver | None


@dataclass(frozen=True, eq=False)
class _Step:
    u: FloatArray
    travel: float
    slope: float
    longest: float
    cg_iterations: int
    negative: bool


def minimise(
    level: Level,
    start: State,
    press: Press,
    factory: LinearSolverFactory,
    tolerance_mm: float,
    max_iterations: int = MAX_ITERATIONS,
) -> Result:
    """Find the equilibrium nearest to `start`.

    Converged when a full step moves no node by more than `tolerance_mm`.
    """
    state = start
    energy = level.energy(state.x, press.at(state.travel_mm))
    cg_total, residual, last_residual = 0, np.inf, np.inf
    forcing = LOOSEST
    linear: LinearSolver | None = None
    convex = False
    moving = press.force_n is not None
    for iteration in range(1, max_iterations + 1):
        force, tangent = level.linearise(state.x, energy, moving_plate=moving, convex=convex)
        if moving and tangent.plate_stiffness == 0:
            return Result(state, "the plate lost contact", iteration, cg_total, residual, linear)
        residual = _residual(force, energy, press)
        if np.isfinite(last_residual):
            forcing = min(LOOSEST, max(TIGHTEST, 0.5 * (residual / last_residual) ** 1.5))
        last_residual = residual
        linear = factory(level, tangent)
        step = _direction(level, force, tangent, energy, press, linear, forcing)
        cg_total += step.cg_iterations
        if step.negative and not convex:
            # Far from equilibrium the pressure may turn the tangent indefinite: leave it out.
            _, tangent = level.linearise(state.x, energy, moving_plate=moving, convex=True)
            linear = factory(level, tangent)
            step = _direction(level, force, tangent, energy, press, linear, forcing)
            cg_total += step.cg_iterations
        state, energy, length = _line_search(level, state, energy, press, step)
        gap = press.at(state.travel_mm)
        if gap.upper_mm <= gap.lower_mm:
            return Result(state, "the plates met", iteration, cg_total, residual, linear)
        if length == 0:
            if convex:
                reason = f"no descent at a residual of {residual:.3g} N"
                return Result(state, reason, iteration, cg_total, residual, linear)
            convex = True
        elif length == 1 and step.longest < tolerance_mm:
            return Result(state, "", iteration, cg_total, residual, linear)
    reason = f"{max_iterations} Newton iterations left a residual of {residual:.3g} N"
    return Result(state, reason, max_iterations, cg_total, residual, linear)


def _residual(force: FloatArray, energy: Energy, press: Press) -> float:
    plate = 0.0 if press.force_n is None else energy.touch.upper_force - press.force_n
    return float(np.sqrt(np.vdot(force, force) + plate**2))


def _direction(
    level: Level,
    force: FloatArray,
    tangent: Tangent,
    energy: Energy,
    press: Press,
    linear: LinearSolver,
    forcing: float,
) -> _Step:
    """The Newton direction, turned downhill if need be and cut to a trusted length."""
    b = -force
    plate = 0.0
    if press.force_n is not None:
        plate = energy.touch.upper_force - press.force_n
        b[tangent.pads, 1] += tangent.coupling * (plate / tangent.plate_stiffness)
    correction = linear.solve(b, forcing)
    u, travel = correction.u, 0.0
    if press.force_n is not None:
        travel = (-plate - float(tangent.coupling @ u[tangent.pads, 1])) / tangent.plate_stiffness
    slope = float(np.vdot(force, u)) + plate * travel
    if slope > 0:
        u, travel, slope = -u, -travel, -slope
    return _Step(
        u, travel, slope, float(np.abs(u).max()), correction.iterations, correction.negative
    )


def _line_search(
    level: Level, state: State, energy: Energy, press: Press, step: _Step
) -> tuple[State, Energy, float]:
    """Backtrack until the potential falls; length 0 means that it never did."""
    potential = energy.stored - press.work(state.travel_mm)
    length = min(1.0, LONGEST_STEP_MM / step.longest) if step.longest > 0 else 1.0
    # Near the minimum the fall drowns in rounding; a Newton step is then taken on trust.
    noise = 1e-11 * (abs(energy.stored) + abs(press.work(state.travel_mm)))
    for _ in range(MAX_HALVINGS):
        trial = State(state.x + length * step.u, state.travel_mm + length * step.travel)
        trial_energy = level.energy(trial.x, press.at(trial.travel_mm))
        fall = trial_energy.stored - press.work(trial.travel_mm) - potential
        if fall <= 1e-4 * length * step.slope or (-length * step.slope <= noise and fall <= noise):
            return trial, trial_energy, length
        length /= 2
    return state, energy, 0.0
