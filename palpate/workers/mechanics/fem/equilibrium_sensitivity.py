r"""Derivatives of an equilibrium with respect to changes in the problem, by one linear solve each.

With the out-of-balance force R(x, phi) = 0 at an equilibrium,

.. math:: K \, dx/d\phi = - \partial R / \partial \phi .

The right-hand side is a difference of two forces at the same positions, which costs no
solve. Where friction or follower pressure act, their non-symmetric derivative with respect to x is
added; see `coupled_tangent`. With friction, the slip of earlier load steps is held.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem import sparse_products
from palpate.workers.mechanics.fem.body_equilibrium import (
    Equilibrium,
    NoStressFreeShapeError,
    hanging_problem,
    stress_free,
)
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.fem.discretisation import History, Model, Stage, State
from palpate.workers.mechanics.fem.energy_minimisation import minimise
from palpate.workers.mechanics.fem.external_forces import dirichlet_conditions
from palpate.workers.mechanics.fem.level_equilibrium import CoupledTangent
from palpate.workers.mechanics.fem.load_path import bring_into_contact, friction_fractions, stage_at
from palpate.workers.mechanics.fem.mesh_level import Level, Tangent
from palpate.workers.mechanics.fem.multigrid import linear_solver, solver_factory
from palpate.workers.mechanics.fem.plate_contact import PlateFriction

# Relative error of the linear solves.
RELATIVE_ERROR = 1e-5


def tangents(
    at: Equilibrium, changes: Sequence[Change], tolerance: float = RELATIVE_ERROR
) -> FloatArray:
    """Return the derivative of the displacement for each change.

    Parameters
    ----------
    at : Equilibrium
        Converged.
    changes : sequence of Change
    tolerance : float
        Relative error of the linear solves; see `krylov_solvers.solve_many_by_cg`.

    Returns
    -------
    ndarray, shape (k, n, 3)
        Derivative of the finest nodes' displacement, in mm per unit of the parameter.

    Raises
    ------
    InputError
        If `at` did not converge.
    """
    _refuse_unconverged(at)
    if not changes:
        return np.empty((0, *at.solution.displacement_mm.shape))
    return _solved(_Linearisation(at), changes, tolerance)[1]


def tangents_with_reactions(
    at: Equilibrium, changes: Sequence[Change], tolerance: float = RELATIVE_ERROR
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the displacement and of the reactions for each change.

    Parameters
    ----------
    at, changes, tolerance
        See `tangents`; without friction and follower pressure.

    Returns
    -------
    moved : ndarray, shape (k, n, 3)
        As returned by `tangents`.
    reactions : ndarray, shape (k, n, 3)
        In N per unit of the parameter, zero where a node is free; see `reactions`.

    Raises
    ------
    InputError
        If `at` did not converge.
    """
    _refuse_unconverged(at)
    if not changes:
        return (np.empty((0, *at.solution.displacement_mm.shape)),) * 2
    here = _Linearisation(at)
    right, moved = _solved(here, changes, tolerance)
    return moved, np.stack([here.reactions(r, u) for r, u in zip(right, moved, strict=True)])


def reactions(at: Equilibrium) -> FloatArray:
    """Return the reactions at the held nodes, shape (n, 3), in N."""
    level, state = at.levels[-1], at.states[-1]
    force = level.force(state, level.energy(state, at.stage), at.stage)
    return np.where(level.free > 0, 0.0, force)


def _refuse_unconverged(at: Equilibrium) -> None:
    if not at.solution.outcome.converged:
        raise InputError(
            "Only an equilibrium has tangents; this simulation did not converge: "
            f"{at.solution.outcome.reason}."
        )


def _solved(
    here: "_Linearisation", changes: Sequence[Change], tolerance: float
) -> tuple[list["_RightSide"], FloatArray]:
    """Return the right-hand side of each change, and the nodes' response, (k, n, 3)."""
    right, equilibrium = [here.right_side(change) for change in changes], here.at
    if equilibrium.levels[-1].is_conservative(equilibrium.states[-1]):
        solutions = list(here.solve_symmetric(right, tolerance))
    else:
        solutions = [here.solve_nonsymmetric(r, tolerance) for r in right]
    free = equilibrium.levels[-1].free > 0
    moved = [np.where(free, u, r.prescribed) for u, r in zip(solutions, right, strict=True)]
    return right, np.stack(moved)


@dataclass(frozen=True, slots=True, eq=False)
class _RightSide:
    """Right-hand side of a linear solve.

    Parameters
    ----------
    force : ndarray, shape (n, 3)
        Force on the nodes, in N per unit of the parameter.
    plate : float
        Force on the plates.
    prescribed : ndarray, shape (n, 3)
        Motion of held nodes, in mm per unit of the parameter.
    unbalanced : ndarray, shape (n, 3)
        Change in the forces at fixed positions, on all nodes including held ones.
    """

    force: FloatArray
    plate: float
    prescribed: FloatArray
    unbalanced: FloatArray


class _Linearisation:
    """Linearisation of the finest level about its equilibrium."""

    def __init__(self, at: Equilibrium) -> None:
        self.at = at
        self.level, self.state, self.stage = at.levels[-1], at.states[-1], at.stage
        self.energy = self.level.energy(self.state, self.stage)
        _, self.tangent = self.level.linearise(self.state, self.energy, self.stage)
        eigenvector = self.state.history.eigenvector
        self.linear = linear_solver(self.level, self.tangent, at.solvers[:-1], eigenvector)
        self._frictionless: list[State] | None = None
        self._inner: FloatArray | None = None

    def right_side(self, change: Change) -> _RightSide:
        """Return the negative out-of-balance force per unit of the parameter."""
        ahead, behind = (self._forces(p) for p in (change.plus, change.minus))
        unbalanced = (ahead[0] - behind[0]) / change.step
        b = -unbalanced * self.level.free
        plate = -(ahead[1] - behind[1]) / change.step
        prescribed = self._prescribed(change)
        if prescribed.any():
            b -= self._stiffness_times(prescribed) * self.level.free
        return _RightSide(b, plate, prescribed, unbalanced)

    def reactions(self, right: _RightSide, moved: FloatArray) -> FloatArray:
        """Return the change in the reactions when the nodes move by `moved`, shape (n, 3)."""
        change = right.unbalanced + self._stiffness_times(moved)
        return np.where(self.level.free > 0, 0.0, change)

    def _forces(self, problem: Problem) -> tuple[FloatArray, float]:
        """Return the out-of-balance forces on nodes and plates under another problem."""
        if problem is self.at.problem:
            return self._own_forces
        model = self._model_of(problem)
        level = Level.build(model.finest, problem, self.level)
        stage = stage_at(model, problem.load, self.stage.fraction)
        return self._forces_of(level, self._state_under(level, stage), stage)

    @cached_property
    def _own_forces(self) -> tuple[FloatArray, float]:
        return self._forces_of(self.level, self.state, self.stage)

    def _forces_of(self, level: Level, state: State, stage: Stage) -> tuple[FloatArray, float]:
        if self._is_touched_alike(level, state, stage):
            energy = self.energy
        elif level.model is self.level.model:  # same positions: their volumes are known
            contacts, contact = level.contact(state, stage)
            energy = replace(self.energy, plate_contacts=contacts, contact=contact)
        else:
            energy = level.energy(state, stage)
        plate = 0.0
        if stage.force_n is not None:
            plate = energy.contact.travel_force - stage.force_n
        same_skin = level.problem.membrane == self.at.problem.membrane
        if level.constants is self.level.constants and same_skin:
            inner = self._inner_force()
            return inner + level.outer_force(state, energy.contact, stage), plate
        return level.force(state, energy, stage), plate

    def _is_touched_alike(self, level: Level, state: State, stage: Stage) -> bool:
        """Test whether volumes and plates are unchanged, as for a change inside the body."""
        friction = state.history.friction or self.state.history.friction
        return level.model is self.level.model and stage == self.stage and not friction

    def _inner_force(self) -> FloatArray:
        """Return the present force of body and skin, shape (n, 3)."""
        if self._inner is None:
            whole = self.level.force(self.state, self.energy, self.stage)
            outer = self.level.outer_force(self.state, self.energy.contact, self.stage)
            self._inner = whole - outer
        return self._inner

    def _model_of(self, problem: Problem) -> Model:
        """Return the stress-free model of another problem, which depends on the constants too.

        If that problem has none, because the body can barely carry its weight here, it is the
        present model.
        """
        if not any(problem.imaged_gravity_g):
            return self.at.imaged
        if hanging_problem(problem) == hanging_problem(self.at.problem):
            return self.at.model
        try:
            return stress_free(self.at.imaged, problem)
        except NoStressFreeShapeError:
            return self.at.model

    def _state_under(self, level: Level, stage: Stage) -> State:
        """Return the present positions with the history of another problem.

        Friction is unchanged, or starts from the end of a frictionless path.
        """
        coefficient = stage.device.friction
        friction: tuple[PlateFriction, ...] = ()
        if coefficient:
            friction = self.state.history.friction or self._friction_of_path(level)
        friction = tuple(replace(f, coefficient=coefficient) for f in friction)
        state = State(self.state.x, self.state.travel_mm, History(friction))
        return level.update_history(state, stage)

    def _friction_of_path(self, level: Level) -> tuple[PlateFriction, ...]:
        """Return friction whose slip origins follow the frictionless path."""
        stages = [replace(s, device=replace(s.device, friction=1.0)) for s in self._stages()]
        state = level.begin_step(State(level.model.nodes.copy(), 0.0), stages[0])
        ends = self._frictionless_path()
        for end, stage, following in zip(ends, stages[:-1], stages[1:], strict=True):
            state = level.update_history(state.moved_to(end.x, end.travel_mm), stage)
            state = level.begin_step(state, following)
        return state.history.friction

    def _stages(self) -> list[Stage]:
        """Return the load steps in which friction would be applied."""
        problem = self.at.problem
        fractions = friction_fractions(problem)
        return [stage_at(self.at.model, problem.load, f) for f in fractions]

    def _frictionless_path(self) -> list[State]:
        """Return the states at the ends of those steps without friction, except the last."""
        if self._frictionless is None:
            state, path = self.state.with_eigenvector(self.linear.eigenvector), []
            for stage in reversed(self._stages()[:-1]):
                x = self.level.with_prescribed(state.x, stage.fraction)
                near = state.moved_to(x, state.travel_mm)
                state = minimise(
                    self.level,
                    bring_into_contact(self.level, near, stage),
                    stage,
                    solver_factory(self.at.solvers[:-1]),
                    self.at.problem.tolerance_mm,
                ).state
                path.append(state)
            self._frictionless = path[::-1]
        return self._frictionless

    def _prescribed(self, change: Change) -> FloatArray:
        """Return the motion of held nodes due to the change: (n, 3) in mm per unit.

        A wall that begins to yield under its reaction r moves by r / (area x spring).
        """
        level, wall = self.level, change.plus.wall
        prescribed = np.zeros_like(level.prescribed_mm)
        if change.plus.holds != change.minus.holds:
            ahead, behind = (
                dirichlet_conditions(level.model, p) for p in (change.plus, change.minus)
            )
            prescribed += (ahead.displacement_mm - behind.displacement_mm) / change.step
        for axis, held in enumerate(level.problem.wall.held):
            if held and not wall.held[axis]:
                nodes = level.model.wall
                stiffness = level.model.wall_areas[nodes] * wall.spring_mpa_per_mm[axis]
                reaction = level.force(self.state, self.energy, self.stage)[nodes, axis]
                prescribed[nodes, axis] -= reaction / stiffness / change.step
        return np.where(level.free > 0, 0.0, prescribed)

    def _stiffness_times(self, u: FloatArray) -> FloatArray:
        """Return the nodal forces due to a displacement `u`, including held nodes.

        The plates are not affected: held nodes take no part in their coupling.
        """
        t = self._whole_tangent
        g = self.level.model.graph
        matrix = g.start.view(np.uint32), g.neighbour.view(np.uint32), t.rows
        x, y = np.zeros((2, len(u), 4))
        x[:, :3] = u
        sparse_products.set_pressure(*matrix, x)
        sparse_products.multiply(*matrix, x, y)
        return y[:, :3]

    @cached_property
    def _whole_tangent(self) -> Tangent:
        """Tangent with the rows and columns of held nodes."""
        _, found = self.level.linearise(self.state, self.energy, self.stage, everywhere=True)
        return found

    def solve_symmetric(self, right: Sequence[_RightSide], tolerance: float) -> FloatArray:
        """Solve for all right-hand sides at once, shape (k, n, 3)."""
        t = self.tangent
        b = np.stack([r.force for r in right])
        if t.plate_stiffness > 0:
            push = np.array([r.plate for r in right]) / t.plate_stiffness
            b[:, t.contact_index] -= push[:, None, None] * t.coupling
        return self.linear.solve_many(b, tolerance).u

    def solve_nonsymmetric(self, right: _RightSide, tolerance: float) -> FloatArray:
        """Solve with the complete, non-symmetric tangent, shape (n, 3)."""
        found, _ = self._coupled.solve(right.force, right.plate, tolerance)
        if found.error > tolerance:
            raise ArithmeticError("the tangent with friction or pressure was not solved")
        return found.u

    @cached_property
    def _coupled(self) -> CoupledTangent:
        parts = self.level, self.state, self.energy, self.stage, self.tangent, self.linear
        return CoupledTangent(*parts)
