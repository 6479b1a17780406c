r"""Tangent of an equilibrium with friction or follower pressure, which have no energy.

It adds their derivative N in positions and travel to the symmetric tangent K. Friction follows
the normal force, mu (d lambda) w with the direction w, and lambda is as stiff as the plates:
pressing a node in by a micrometre drags it along with a force comparable to its support.
Multiplied by :math:`1 + \mu w n^T` from the left, K + N has the stiff part of K, which is
therefore a good preconditioner.
"""

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.elements.external_forces import pressure_derivative
from palpate.workers.mechanics.fem.elements.states import Stage, State
from palpate.workers.mechanics.fem.linear import gmres
from palpate.workers.mechanics.fem.linear.conjugate_gradients import Correction
from palpate.workers.mechanics.fem.linear.level import Energy, Level, Tangent
from palpate.workers.mechanics.fem.linear.multigrid import LinearSolver


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
            (f.nodes.index[at], contact.at_nodes.gradient[at], direction[at])
            for f, contact, direction in self._rough
            for at in [np.flatnonzero(contact.gap < 0)]
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
        found = gmres.solve(self._multiply, self._precondition, b, tolerance)
        if not self._moves:
            return found, 0.0
        _, on_plate = self._without_energy(found.u, 0.0)
        along = float(np.vdot(t.coupling, found.u[t.contact_index]))
        return found, (plate - along - on_plate) / self._plate_stiffness

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
