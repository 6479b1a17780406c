r"""How an equilibrium moves when the problem changes: one linear solve each.

With the out-of-balance force R(x, phi) = 0 at an equilibrium,

.. math:: K \, dx/d\phi = - \partial R / \partial \phi .

The right side is a difference of two forces at the same place, which costs no
solve. Where friction or follower pressure act, their derivative by x, which is not
symmetric, is added by GMRES around the symmetric solver. With friction the slip of
earlier steps of the load is held.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from storage.errors import InputError
from storage.values import FloatArray
from workers.fem import rows
from workers.fem.level import Energy, Level, Stage, State
from workers.fem.model import Model
from workers.fem.multigrid import LinearSolver
from workers.fem.newton import minimise, solve_bordered
from workers.fem.outside import held_places, pressure_derivative
from workers.fem.problem import Problem
from workers.fem.rest import stress_free
from workers.fem.settle import linear_solver
from workers.fem.solve import Equilibrium, equilibrium
from workers.fem.steps import in_contact, path_fractions, stage_at

# Of the linear solves.
RELATIVE_ERROR = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Two problems on either side of the present one, `step` apart in a parameter."""

    plus: Problem
    minus: Problem
    step: float


def tangents(
    at: Equilibrium, changes: Sequence[Change], tolerance: float = RELATIVE_ERROR
) -> FloatArray:
    """Derivative of the displacement by each change.

    Parameters
    ----------
    at : Equilibrium
        Converged.
    changes : sequence of Change
    tolerance : float
        Relative error of the linear solves; see `workers.fem.conjugate.solve_many`.

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
    if not changes:
        return np.empty((0, *at.solution.displacement_mm.shape))
    here = _Here(at)
    right = [here.right_side(change) for change in changes]
    if at.levels[-1].lags:
        # GMRES measures residuals, which say less of the displacement than errors do.
        found = [here.with_lag(r, tolerance / 10) for r in right]
    else:
        found = list(here.without_lag(right, tolerance))
    free = at.levels[-1].free > 0
    return np.stack([np.where(free, u, r.forced) for u, r in zip(found, right, strict=True)])


@dataclass(frozen=True, slots=True, eq=False)
class _RightSide:
    """Force on the nodes, (n, 3), and on the plates, and what held places do, (n, 3)."""

    force: FloatArray
    plate: float
    forced: FloatArray


class _Here:
    """The finest level at its equilibrium, ready to be changed."""

    def __init__(self, at: Equilibrium) -> None:
        self.at = at
        self.level, self.state, self.stage = at.levels[-1], at.states[-1], at.stage
        self.energy = self.level.energy(self.state, self.stage)
        _, self.tangent_here = self.level.linearise(self.state, self.energy, self.stage)
        self.linear: LinearSolver = linear_solver(self.level, self.tangent_here, at.solvers[:-1])
        self._earlier: list[State] | None = None
        self._inner: FloatArray | None = None

    def right_side(self, change: Change) -> _RightSide:
        """What a unit of the parameter leaves out of balance, with its sign turned."""
        ahead, behind = (self._forces(p) for p in (change.plus, change.minus))
        b = -(ahead[0] - behind[0]) / change.step * self.level.free
        plate = -(ahead[1] - behind[1]) / change.step
        forced = self._forced(change)
        if forced.any():
            b -= self._pull(forced) * self.level.free
        return _RightSide(b, plate, forced)

    def _forces(self, problem: Problem) -> tuple[FloatArray, float]:
        """Out-of-balance force of the nodes and of the plates under another problem."""
        if problem is self.at.problem:
            level, stage = self.level, self.stage
        else:
            model = self._model_of(problem)
            level = Level(model.finest, problem, self.level)
            stage = stage_at(model, problem.load, self.stage.fraction)
            self._grip(level, stage)
        if level.model is self.level.model:  # the same place: its volumes are known
            presses, contact = level.contact(self.state, stage)
            energy = replace(self.energy, presses=presses, contact=contact)
        else:
            energy = level.energy(self.state, stage)
        plate = 0.0
        if stage.force_n is not None:
            plate = energy.contact.travel_force - stage.force_n
        if level.made_of is self.level.made_of and problem.membrane == self.at.problem.membrane:
            inner = self._inner_force()
            return inner + level.outer_force(self.state, energy.contact, stage), plate
        return level.force(self.state, energy, stage), plate

    def _inner_force(self) -> FloatArray:
        """Force of body and skin as they are, shape (n, 3)."""
        if self._inner is None:
            whole = self.level.force(self.state, self.energy, self.stage)
            outer = self.level.outer_force(self.state, self.energy.contact, self.stage)
            self._inner = whole - outer
        return self._inner

    def _model_of(self, problem: Problem) -> Model:
        if problem.imaged_gravity_g == self.at.problem.imaged_gravity_g:
            return self.at.model
        if not any(problem.imaged_gravity_g):
            return self.at.imaged
        return stress_free(self.at.imaged, problem, equilibrium)

    def _grip(self, level: Level, stage: Stage) -> None:
        """Friction as it is, or as it would begin at the end of a path without any."""
        mu = stage.device.friction
        if mu:
            level.grips = self.level.grips
            if not level.grips:
                self._walk(level)
            level.grips = tuple(replace(g, friction=mu) for g in level.grips)
        level.renew(self.state, stage)

    def _walk(self, level: Level) -> None:
        """Let the anchors of friction follow the path without any."""
        stages = [replace(s, device=replace(s.device, friction=1.0)) for s in self._stages()]
        rest = State(level.model.nodes.copy(), 0.0)
        level.begin_step(rest, stages[0])
        for earlier, stage, following in zip(self._path(), stages[:-1], stages[1:], strict=True):
            level.renew(earlier, stage)
            level.begin_step(earlier, following)

    def _stages(self) -> list[Stage]:
        """The steps in which friction would be applied."""
        load = self.at.problem.load
        return [stage_at(self.at.model, load, f) for f in path_fractions(load)]

    def _path(self) -> list[State]:
        """Where those steps end without friction, the last one left out."""
        if self._earlier is None:
            found, path = self.state, []
            for stage in reversed(self._stages()[:-1]):
                near = State(self.level.placed(found.x, stage.fraction), found.travel_mm)
                found = minimise(
                    self.level,
                    in_contact(self.level, near, stage),
                    stage,
                    lambda level, tangent: linear_solver(level, tangent, self.at.solvers[:-1]),
                    self.at.problem.tolerance_mm,
                ).state
                path.append(found)
            self._earlier = path[::-1]
        return self._earlier

    def _forced(self, change: Change) -> FloatArray:
        """What the change prescribes on held places: (n, 3) in mm per unit.

        A wall that begins to yield under its reaction r moves by r / (area x spring).
        """
        level, wall = self.level, change.plus.wall
        forced = np.zeros_like(level.prescribed)
        if change.plus.holds != change.minus.holds:
            ahead, behind = (held_places(level.model, p) for p in (change.plus, change.minus))
            forced += (ahead.displacement_mm - behind.displacement_mm) / change.step
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
        _, t = self.level.linearise(self.state, self.energy, self.stage, everywhere=True)
        g = self.level.model.graph
        matrix = g.start.view(np.uint32), g.neighbour.view(np.uint32), t.rows
        x, y = np.zeros((2, len(u), 4))
        x[:, :3] = u
        rows.pressurise(*matrix, x)
        rows.multiply(*matrix, x, y)
        return y[:, :3]

    def without_lag(self, right: Sequence[_RightSide], tolerance: float) -> FloatArray:
        """Solve for all right sides at once, shape (k, n, 3)."""
        t = self.tangent_here
        b = np.stack([r.force for r in right])
        if t.plate_stiffness > 0:
            push = np.array([r.plate for r in right]) / t.plate_stiffness
            b[:, t.pads] -= push[:, None, None] * t.coupling
        return self.linear.solve_many(b, tolerance).u

    def with_lag(self, right: _RightSide, tolerance: float) -> FloatArray:
        """Solve with the symmetric tangent, and with what has no energy around it."""
        b, plate = right.force, right.plate
        shape, n = b.shape, b.size

        def operator(v: FloatArray) -> FloatArray:
            force, on_plate = _lagging(
                self.level, self.state, self.energy, self.stage, v[:n].reshape(shape), v[n]
            )
            u, travel = self._symmetric(force * self.level.free, on_plate, tolerance / 10)
            return v + np.append(u.ravel(), travel)

        u, travel = self._symmetric(b, plate, tolerance / 10)
        start = np.append(u.ravel(), travel)
        shifted = LinearOperator((n + 1, n + 1), matvec=operator, dtype=np.float64)
        found, failed = gmres(shifted, start, rtol=tolerance, maxiter=5, restart=30)
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
