r"""How an equilibrium moves when the problem changes: one linear solve each.

With the out-of-balance force R(x, phi) = 0 at an equilibrium,

.. math:: K \, dx/d\phi = - \partial R / \partial \phi .

The right side is a difference of two forces at the same place, which costs no
solve. Where friction or follower pressure act, their derivative by x, which is not
symmetric, is added by GMRES around the symmetric solver. With friction the slip of
earlier steps of the load is held.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from storage.errors import InputError
from storage.values import FloatArray
from workers.fem import operators
from workers.fem.level import Energy, Level, Stage, State
from workers.fem.model import Model
from workers.fem.multigrid import LinearSolver
from workers.fem.newton import minimise, solve_bordered
from workers.fem.outside import pressure_derivative
from workers.fem.problem import Problem
from workers.fem.rest import stress_free
from workers.fem.solve import Equilibrium, equilibrium, linear_solver
from workers.fem.steps import in_contact, path_fractions, stage_at

RELATIVE_RESIDUAL = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Two problems on either side of the present one, `step` apart in a parameter."""

    plus: Problem
    minus: Problem
    step: float


def tangents(
    at: Equilibrium, changes: Sequence[Change], tolerance: float = RELATIVE_RESIDUAL
) -> FloatArray:
    """Derivative of the displacement by each change.

    Parameters
    ----------
    at : Equilibrium
        Converged.
    changes : sequence of Change
    tolerance : float
        Relative residual of the linear solves.

    Returns
    -------
    ndarray, shape (k, n, 3)
        Of the finest nodes, in mm per unit of the parameter.

    Raises
    ------
    InputError
        If `at` did not converge.
    """
    if not at.solution.outcome.converged:
        raise InputError(
            "Only an equilibrium has tangents; this simulation did not converge: "
            f"{at.solution.outcome.reason}."
        )
    here = _Here(at)
    return np.stack([here.tangent(change, tolerance) for change in changes])


class _Here:
    """The finest level at its equilibrium, ready to be changed."""

    def __init__(self, at: Equilibrium) -> None:
        self.at = at
        self.level, self.state, self.stage = at.levels[-1], at.states[-1], at.stage
        self.energy = self.level.energy(self.state, self.stage)
        _, self.tangent_here = self.level.linearise(self.state, self.energy, self.stage)
        self.linear: LinearSolver = linear_solver(self.level, self.tangent_here, at.solvers[:-1])
        self._before: State | None = None

    def tangent(self, change: Change, tolerance: float) -> FloatArray:
        """dx / dphi."""
        ahead, behind = (self._forces(p) for p in (change.plus, change.minus))
        b = -(ahead[0] - behind[0]) / change.step * self.level.free
        plate = -(ahead[1] - behind[1]) / change.step
        forced = self._forced(change)
        if forced.any():
            b -= self._pull(forced) * self.level.free
        u = self._answer(b, plate, tolerance)
        return np.where(self.level.free > 0, u, forced)

    def _forces(self, problem: Problem) -> tuple[FloatArray, float]:
        """Out-of-balance force of the nodes and of the plates under another problem."""
        if problem is self.at.problem:
            level, stage = self.level, self.stage
        else:
            model = self._model_of(problem)
            level = Level(model.finest, problem)
            stage = stage_at(model, problem.load, self.stage.fraction)
            self._grip(level, stage)
        energy = level.energy(self.state, stage)
        plate = 0.0
        if stage.force_n is not None:
            plate = energy.contact.travel_force - stage.force_n
        return level.force(self.state, energy, stage), plate

    def _model_of(self, problem: Problem) -> Model:
        if problem.imaged_gravity_g == self.at.problem.imaged_gravity_g:
            return self.at.model
        if not any(problem.imaged_gravity_g):
            return self.at.imaged
        return stress_free(self.at.imaged, problem, equilibrium)

    def _grip(self, level: Level, stage: Stage) -> None:
        """Friction from where the last step of the load began."""
        if stage.device.friction:
            if self.level.grips:
                first = self.level.grips[0]
                start = self.state.x.copy()
                start[first.pads.nodes] = first.start
                level.begin_step(State(start, first.start_travel_mm), stage)
            else:
                level.begin_step(self._one_step_before(), stage)
        level.renew(self.state, stage)

    def _one_step_before(self) -> State:
        """Where a path of the load without friction would have been one step ago."""
        if self._before is None:
            problem = self.at.problem
            fraction = path_fractions(problem.load)[-2]
            stage = stage_at(self.at.model, problem.load, fraction)
            near = State(self.level.placed(self.state.x, fraction), self.state.travel_mm)
            result = minimise(
                self.level,
                in_contact(self.level, near, stage),
                stage,
                lambda level, tangent: linear_solver(level, tangent, self.at.solvers[:-1]),
                problem.tolerance_mm,
            )
            self._before = result.state
        return self._before

    def _forced(self, change: Change) -> FloatArray:
        """What the change prescribes on held places: (n, 3) in mm per unit.

        A wall that begins to yield under its reaction r moves by r / (area x spring).
        """
        level, wall = self.level, change.plus.wall
        forced = np.zeros_like(level.prescribed)
        if change.plus.holds != change.minus.holds:
            ahead = Level(level.model, change.plus).prescribed
            forced += (ahead - Level(level.model, change.minus).prescribed) / change.step
        for axis, held in enumerate(level.problem.wall.held):
            if held and not wall.held[axis]:
                nodes = level.model.wall
                stiffness = level.model.wall_areas[nodes] * wall.spring_mpa_per_mm[axis]
                reaction = level.force(self.state, self.energy, self.stage)[nodes, axis]
                forced[nodes, axis] -= reaction / stiffness / change.step
        return np.where(level.free > 0, 0.0, forced)

    def _pull(self, u: FloatArray) -> FloatArray:
        """Force on the nodes of a displacement `u` of held places.

        The plates feel nothing of it: held nodes take no part in their coupling.
        """
        t, g = self.tangent_here, self.level.model.graph
        everywhere = np.ones_like(self.level.free)
        y = np.empty_like(u)
        scratch = np.empty(len(u))
        operators.multiply(g.start, g.neighbour, t.K, t.B, t.D, everywhere, u, scratch, y)
        return y

    def _answer(self, b: FloatArray, plate: float, tolerance: float) -> FloatArray:
        """Solve with the symmetric tangent, and with what has no energy around it."""
        if not self.level.lags:
            return self._symmetric(b, plate, tolerance)[0]
        shape, n = b.shape, b.size

        def operator(v: FloatArray) -> FloatArray:
            force, on_plate = _lagging(
                self.level, self.state, self.energy, self.stage, v[:n].reshape(shape), v[n]
            )
            u, travel = self._symmetric(force * self.level.free, on_plate, tolerance / 10)
            return v + np.append(u.ravel(), travel)

        u, travel = self._symmetric(b, plate, tolerance / 10)
        right = np.append(u.ravel(), travel)
        shifted = LinearOperator((n + 1, n + 1), matvec=operator, dtype=np.float64)
        found, failed = gmres(shifted, right, rtol=tolerance, maxiter=5, restart=30)
        if failed:
            raise ArithmeticError("the tangent with friction or pressure was not solved")
        return np.asarray(found[:n].reshape(shape))

    def _symmetric(self, b: FloatArray, plate: float, tolerance: float) -> tuple[FloatArray, float]:
        correction, travel = solve_bordered(self.linear, self.tangent_here, b, plate, tolerance)
        return correction.u, travel


def _lagging(
    level: Level, state: State, at: Energy, stage: Stage, u: FloatArray, travel: float
) -> tuple[FloatArray, float]:
    """Derivative of friction and follower pressure along (u, travel): on nodes and plates."""
    force, on_plate = np.zeros_like(u), 0.0
    pressures = level.problem.pressures
    if pressures:
        force -= stage.fraction * pressure_derivative(level.model, state.x, pressures, u)
    for grip, found in zip(level.grips, at.presses, strict=False):
        nodes = grip.pads.nodes
        approach = travel * (found.gradient @ grip.plate.velocity)
        approach = approach - (found.gradient * u[nodes]).sum(axis=1)
        gain = grip.friction * grip.pads.stiffness * (found.gap < 0) * approach
        drag = gain[:, None] * grip.direction(state.x, state.travel_mm)
        force[nodes] += drag
        on_plate -= float(drag.sum(axis=0) @ grip.along)
    return force, on_plate
