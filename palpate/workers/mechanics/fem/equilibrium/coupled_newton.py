r"""Newton's method for displacements and friction forces together.

Friction has no energy, so nothing is minimised: each step solves the non-symmetric system of
`coupled_tangent`. The direction w of the friction on a node is a separate unknown, related to
its slip s by

.. math:: \sqrt{s^2 + \epsilon^2} \, w = s ,

and linearised in this form (Chan, Golub and Mulet, SIAM J. Sci. Comput. 20 (1999) 1964): a node
changes from sticking to slipping in one step, however small epsilon is.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.elements.states import Stage, State
from palpate.workers.mechanics.fem.equilibrium.coupled_tangent import CoupledTangent
from palpate.workers.mechanics.fem.equilibrium.newton import (
    LONGEST_STEP_MM,
    LOOSEST,
    TIGHTEST,
    Result,
    plate_residual,
)
from palpate.workers.mechanics.fem.linear.level import Energy, Level
from palpate.workers.mechanics.fem.linear.multigrid import LinearSolverFactory

# Steps along a path of friction take 4 to 8; harder ones are left to the slower updates.
MAX_ITERATIONS = 30
MAX_HALVINGS = 6


@dataclass(frozen=True, eq=False)
class _Step:
    """Newton direction from a state, its slope with friction held, and its linear system."""

    u: FloatArray
    travel: float
    slope: float
    longest: float
    force: FloatArray
    plate: float
    coupled: CoupledTangent

    def size(self, force: FloatArray, plate: float) -> float:
        """Estimate the displacement that the out-of-balance force would cause, a norm in mm."""
        return float(np.linalg.norm(self.coupled.precondition(force, plate)))


def solve_coupled(
    level: Level,
    start: State,
    stage: Stage,
    factory: LinearSolverFactory,
    tolerance_mm: float,
    max_iterations: int = MAX_ITERATIONS,
) -> Result:
    """Find the equilibrium near `start`, friction and follower pressure included.

    Converged when a full step moves no node by more than `tolerance_mm`.
    """
    state = level.update_history(start, stage).with_free_directions()
    energy = level.energy(state, stage)
    cg_total, residual, last, forcing = 0, np.inf, np.inf, LOOSEST
    linear, reason = None, ""
    iteration = 0
    while iteration < max_iterations:
        iteration += 1
        force, tangent = level.linearise(state, energy, stage)
        plate = plate_residual(energy, stage)
        residual = float(np.sqrt(np.vdot(force, force) + plate**2))
        if stage.force_n is not None and tangent.plate_stiffness == 0:
            reason = "the plate lost contact"
            break
        linear = factory(level, tangent, state.history.eigenvector)
        state = state.with_eigenvector(linear.eigenvector)
        coupled = CoupledTangent(level, state, energy, stage, tangent, linear)
        found, travel = coupled.solve(-force, -plate, forcing)
        cg_total += found.iterations
        slope = float(np.vdot(force, found.u)) + plate * travel
        longest = float(np.abs(found.u).max())
        step = _Step(found.u, travel, slope, longest, force, plate, coupled)
        state, energy, length = _line_search(level, state, energy, stage, step)
        if length == 1 and longest < tolerance_mm:
            break
        shrinks = min(1.0, longest / last)
        forcing, last = min(LOOSEST, max(TIGHTEST, 0.5 * shrinks**1.5)), longest
    else:
        reason = f"{max_iterations} Newton iterations left a residual of {residual:.3g} N"
    state = state.with_directions_of_slip()
    return Result(state, reason, iteration, cg_total, residual, linear)


def _line_search(
    level: Level, state: State, energy: Energy, stage: Stage, step: _Step
) -> tuple[State, Energy, float]:
    """Halve the step until it helps, or take the last try: no quantity need fall monotonically.

    A step helps if it lowers the potential with the friction of `state` held, or the error
    estimated from the out-of-balance force with friction updated.
    """
    length = min(1.0, LONGEST_STEP_MM / step.longest) if step.longest > 0 else 1.0
    before: float | None = None
    for attempt in range(MAX_HALVINGS + 1):
        there = state.moved_along(length, step.u, step.travel)
        held = level.energy(there, stage)
        there = level.update_history(there, stage)
        contacts, contact = level.contact(there, stage)
        potential = held.potential - held.contact.energy + contact.energy
        energy_there = replace(held, potential=potential, plate_contacts=contacts, contact=contact)
        fall = held.potential - energy.potential
        if (step.slope < 0 and fall <= 1e-4 * length * step.slope) or attempt == MAX_HALVINGS:
            break
        if before is None:
            before = step.size(step.force, step.plate)
        left = level.force(there, energy_there, stage) * level.free
        if step.size(left, plate_residual(energy_there, stage)) < before:
            break
        length /= 2
    return there, energy_there, length
