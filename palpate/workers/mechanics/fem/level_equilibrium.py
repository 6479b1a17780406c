r"""Equilibrium of one mesh at one load stage, including friction and follower pressure.

Friction and follower pressure have no energy, so nothing is minimised. A `CoupledTangent` adds
their derivative N in positions and travel to the symmetric tangent K. Friction follows
the normal force, mu (d lambda) w with the direction w, and lambda is as stiff as the plates:
pressing a node in by a micrometre drags it along with a force comparable to its support.
Multiplied by :math:`1 + \mu w n^T` from the left, K + N has the stiff part of K, which is
therefore a good preconditioner.

Newton's method for displacements and friction forces together solves this non-symmetric system in
each step. The direction w of the friction on a node is a separate unknown, related to its slip s by

.. math:: \sqrt{s^2 + \epsilon^2} \, w = s ,

and linearised in this form (Chan, Golub and Mulet, SIAM J. Sci. Comput. 20 (1999) 1964): a node
changes from sticking to slipping in one step, however small epsilon is. Where that fails, and for
follower pressure alone, the forces are held while an energy is minimised, then updated.

Newton's method ends when its last full step is short. In a body that is very stiff for its
load every step is short, in equilibrium or not; so the forces of the last state are
compared with the load.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem import krylov_solvers
from palpate.workers.mechanics.fem.discretisation import Stage, State
from palpate.workers.mechanics.fem.energy_minimisation import (
    LONGEST_STEP_MM,
    LOOSEST,
    TIGHTEST,
    Result,
    minimise,
    plate_residual,
)
from palpate.workers.mechanics.fem.external_forces import pressure_derivative
from palpate.workers.mechanics.fem.krylov_solvers import Correction
from palpate.workers.mechanics.fem.mesh_level import Energy, Level, Tangent, without_laws
from palpate.workers.mechanics.fem.multigrid import LinearSolver, LinearSolverFactory

# Largest fraction of the load that may be out of balance, or missing on the plates.
LARGEST_UNBALANCED_SHARE = 1e-3
# Problems with a looser tolerance than this are allowed a proportionally larger fraction:
# the diagnosis solves such ones where a column only selects what to fit.
USUAL_TOLERANCE_MM = 2e-3
# Smaller forces are rounding errors: the body is not loaded.
ROUNDING_N = 1e-7


def equilibrium_fault(
    level: Level, state: State, at: Energy, stage: Stage, force: FloatArray
) -> str:
    """Return the reason why a state is not in equilibrium, with the residual; empty if it is.

    Parameters
    ----------
    level : Level
    state, at : State and Energy
        The last state, and its energy.
    stage : Stage
        The full load.
    force : ndarray, shape (n, 3)
        Out-of-balance force on every node in N, including held ones.
    """
    load_n = load_size_n(level, state, at, stage, force)
    allowed = LARGEST_UNBALANCED_SHARE * max(1.0, level.problem.tolerance_mm / USUAL_TOLERANCE_MM)
    allowed_n = max(allowed * load_n, ROUNDING_N)
    residual_n = float(np.linalg.norm(force * level.free))
    missing_n = 0.0 if stage.force_n is None else abs(at.contact.travel_force - stage.force_n)
    if residual_n <= allowed_n and missing_n <= allowed_n:
        return ""
    what, size_n = (
        ("forces on the plates miss the load by", missing_n)
        if missing_n > allowed_n
        else ("forces out of balance are", residual_n)
    )
    share = f"{size_n / load_n:.2g} of the load" if load_n > 0 else "without a load"
    return f"not in equilibrium: {what} {size_n:.3g} N, {share}; {allowed:g} is allowed"


def load_size_n(level: Level, state: State, at: Energy, stage: Stage, force: FloatArray) -> float:
    """Return the size of the load in N: plates, forces, prescribed displacements.

    If none of these act, it is the size of the reactions of the supports.
    """
    plates_n = stage.force_n if stage.force_n is not None else max(at.plate_forces)
    follower = state.history.follower_force
    outer = level.dead_load if follower is None else level.dead_load + follower
    reactions = np.abs(force * (1 - level.free))
    moved_n = float(reactions[level.prescribed_mm != 0].sum())
    load_n = max(plates_n, float(np.abs(outer).sum()), moved_n)
    return load_n if load_n > ROUNDING_N else float(reactions.sum())


class CoupledTangent:
    """Derivative of all forces with respect to positions and the travel of the plates.

    Parameters
    ----------
    level, stage : Level and Stage
    state, energy : State and Energy
        With friction and pressure up to date.
    tangent, linear : Tangent and LinearSolver
        The symmetric part, and its solver.
    """

    def __init__(
        self,
        level: Level,
        state: State,
        energy: Energy,
        stage: Stage,
        tangent: Tangent,
        linear: LinearSolver,
    ) -> None:
        self._level, self._x, self._stage = level, state.x, stage
        self._tangent, self._linear = tangent, linear
        self._rough = [
            (f, contact, f.coefficient * f.direction(state.x, state.travel_mm))
            for f, contact in zip(state.history.friction, energy.plate_contacts, strict=False)
        ]
        self._pressed = [
            (f.nodes.index[touching], contact.at_nodes.gradient[touching], direction[touching])
            for f, contact, direction in self._rough
            for touching in [np.flatnonzero(contact.gap < 0)]
        ]
        self._by_travel, on_plate = self._without_energy(np.zeros_like(state.x), 1.0)
        self._plate_stiffness = tangent.plate_stiffness + on_plate
        self._moves = tangent.plate_stiffness > 0

    def solve(self, force: FloatArray, plate: float, tolerance: float) -> tuple[Correction, float]:
        """Solve for displacement and travel under nodal forces, (n, 3) in N, and a plate force."""
        t, b = self._tangent, force.copy()
        if self._moves:
            share = plate / self._plate_stiffness
            b[t.contact_index] -= share * t.coupling
            b -= share * self._by_travel
        correction = krylov_solvers.solve_by_gmres(self._multiply, self._precondition, b, tolerance)
        if not self._moves:
            return correction, 0.0
        _, on_plate = self._without_energy(correction.u, 0.0)
        along = float(np.vdot(t.coupling, correction.u[t.contact_index]))
        return correction, (plate - along - on_plate) / self._plate_stiffness

    def precondition(self, force: FloatArray, plate: float) -> FloatArray:
        """Estimate the displacement of the nodes under a force, shape (n, 3) in mm."""
        t, b = self._tangent, np.zeros((len(force), 4))
        b[:, :3] = force
        if self._moves:
            share = plate / self._plate_stiffness
            b[t.contact_index, :3] -= share * t.coupling
            b[:, :3] -= share * self._by_travel
        return self._precondition(b)[:, :3]

    def _multiply(self, v: FloatArray) -> FloatArray:
        """Return the complete tangent times `v`, (n, 4), with the travel eliminated."""
        x, y, t = v.copy(), np.zeros_like(v), self._tangent
        self._linear.multiply(x, y)
        force, on_plate = self._without_energy(v[:, :3], 0.0)
        y[:, :3] += force
        if self._moves:
            along = float(np.vdot(t.coupling, v[t.contact_index, :3]))
            travel = -(along + on_plate) / self._plate_stiffness
            more = travel + along / t.plate_stiffness
            y[t.contact_index, :3] += more * t.coupling
            y[:, :3] += travel * self._by_travel
        return y

    def _precondition(self, r: FloatArray) -> FloatArray:
        """Estimate the displacement under a force, both (n, 4)."""
        r = r.copy()
        for index, normal, direction in self._pressed:
            r[index, :3] += (normal * r[index, :3]).sum(axis=1, keepdims=True) * direction
        r[:, :3] *= self._level.free
        z = self._linear.approximate(r)
        z[:, 3] = 0
        return z

    def _without_energy(self, u: FloatArray, travel: float) -> tuple[FloatArray, float]:
        """Differentiate friction and pressure along (u, travel): on nodes, (n, 3), and plates."""
        force, on_plate = np.zeros_like(u), 0.0
        pressures = self._level.problem.pressures
        if pressures:
            change = pressure_derivative(self._level.model, self._x, pressures, u)
            force -= self._stage.fraction * change
        for friction, contact, direction in self._rough:
            index = friction.nodes.index
            drag = contact.normal_force_change(u[index], travel)[:, None] * direction
            force[index] += drag
            on_plate -= float(drag.sum(axis=0) @ friction.sliding_velocity)
        return force * self._level.free, on_plate


# Steps along a path of friction take 4 to 8; harder ones are left to the slower updates.
MAX_COUPLED_ITERATIONS = 30
MAX_COUPLED_HALVINGS = 6


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
    max_iterations: int = MAX_COUPLED_ITERATIONS,
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
        correction, travel = coupled.solve(-force, -plate, forcing)
        cg_total += correction.iterations
        slope = float(np.vdot(force, correction.u)) + plate * travel
        longest = float(np.abs(correction.u).max())
        step = _Step(correction.u, travel, slope, longest, force, plate, coupled)
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
    for attempt in range(MAX_COUPLED_HALVINGS + 1):
        there = state.moved_along(length, step.u, step.travel)
        held = level.energy(there, stage)
        there = level.update_history(there, stage)
        contacts, contact = level.contact(there, stage)
        potential = held.potential - held.contact.energy + contact.energy
        energy_there = replace(held, potential=potential, plate_contacts=contacts, contact=contact)
        fall = held.potential - energy.potential
        if (
            step.slope < 0 and fall <= 1e-4 * length * step.slope
        ) or attempt == MAX_COUPLED_HALVINGS:
            break
        if before is None:
            before = step.size(step.force, step.plate)
        left = level.force(there, energy_there, stage) * level.free
        if step.size(left, plate_residual(energy_there, stage)) < before:
            break
        length /= 2
    return there, energy_there, length


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
        minimum = minimise(relaxed, start.with_eigenvector(None), stage, factory, tolerance_mm)
        start = start.moved_to(minimum.state.x, minimum.state.travel_mm)
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
    limit = min(MAX_COUPLED_ITERATIONS, max_iterations or MAX_COUPLED_ITERATIONS)
    if level.model.transfer is not None:
        return solve_coupled(level, start, stage, factory, tolerance_mm, limit)
    near = minimise(level, start, stage, factory, max(FIRST_TOLERANCE_MM, tolerance_mm))
    if near.reason:
        return near
    coupled = solve_coupled(level, near.state, stage, factory, tolerance_mm, limit)
    newton, cg = near.iterations + coupled.iterations, near.cg_iterations + coupled.cg_iterations
    return replace(coupled, iterations=newton, cg_iterations=cg)


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
        if result.reason or not _fault_of_forces(level, result.state, stage):
            break
        tolerance_mm *= TIGHTER
        again = solve_level(level, result.state, stage, factory, tolerance_mm, max_iterations)
        newton = result.iterations + again.iterations
        cg = result.cg_iterations + again.cg_iterations
        result = replace(again, iterations=newton, cg_iterations=cg)
    return result


def _fault_of_forces(level: Level, state: State, stage: Stage) -> str:
    """Return the reason why the forces on a level are not balanced; empty if they are."""
    at = level.energy(state, stage)
    return equilibrium_fault(level, state, at, stage, level.force(state, at, stage))
