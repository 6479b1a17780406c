"""Newton's method with a line search on the energy."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix

from palpate.storage.errors import PalpateError
from palpate.workers.blind.solver.system import State, System, Tangent
from palpate.workers.blind.solver.two_level_solver import (
    LinearSolution,
    TwoLevel,
    conjugate_gradients,
    factorised_coarse_tangent,
)

FORCE_TOLERANCE = 2e-5  # fraction of the plate's force that may be out of balance
EXACT_FRICTION_BELOW = 0.02  # fraction of the force below which friction has its exact tangent
MAX_STEPS = 120
ENERGY_SLACK = 1e-9  # fraction of the energy that rounding may add


class NoEquilibriumError(PalpateError):
    """Failure of Newton's method to find an equilibrium."""


@dataclass(frozen=True, slots=True)
class SolverEffort:
    """Numbers of Newton steps and of conjugate gradient iterations."""

    steps: int
    iterations: int


def interpolation_of(system: System) -> csc_matrix:
    """Return the interpolation matrix from corners to all nodes, (n, c)."""
    ends = system.topology.mesh.ends
    rows = np.repeat(np.arange(len(ends)), 2)
    shape = (len(ends), system.topology.mesh.corners)
    return coo_matrix((np.full(2 * len(ends), 0.5), (rows, ends.ravel())), shape=shape).tocsc()


class Newton:
    """Equilibrium solver that reuses the coarse factorisation between solutions.

    Parameters
    ----------
    system : System
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.interpolation = interpolation_of(system)
        starts, columns = system.topology.pattern
        self._diagonal = np.repeat(np.arange(len(starts) - 1), np.diff(starts)) == columns
        self._factor: Any = None
        self._fresh = 0
        self._last = 0

    def equilibrium(
        self, state: State, force_n: float, tolerance: float = FORCE_TOLERANCE
    ) -> tuple[State, SolverEffort]:
        """Find the equilibrium under a force, from a state near it.

        Parameters
        ----------
        state : State
        force_n : float
            Force that closes the plates.
        tolerance : float
            Fraction of that force that may be out of balance.

        Returns
        -------
        State, Effort

        Raises
        ------
        NoEquilibriumError
            If the iteration does not converge.
        """
        system = self.system
        total = 0
        before = np.inf
        for step in range(MAX_STEPS):
            if system.has_friction:
                system.renew_friction(state)
            force, tangent = system.linearised(state, force_n, exact=before < EXACT_FRICTION_BELOW)
            size = float(np.sqrt((force.u**2).sum() + force.travel**2)) / force_n
            if size < tolerance:
                return state, SolverEffort(step, total)
            forcing = min(0.1, max(0.003, 0.5 * (size / before) if np.isfinite(before) else 0.1))
            before = size
            solved = self._solve(force, tangent, forcing)
            total += solved.iterations
            moved = self._searched(state, State(solved.u, solved.travel), force, force_n)
            if moved is None:
                # A factorisation from an unstable state may point uphill; nodal scaling does not.
                self._factor = None
                moved = self._searched(state, self._downhill(force, tangent), force, force_n)
            if moved is None:
                break
            state = moved
        # A factorisation from this state would mislead another attempt.
        self._factor = None
        raise NoEquilibriumError(
            f"No equilibrium under {force_n:g} N: {size:.1e} of the force is out of balance "
            f"after {step + 1} steps."
        )

    def _solve(self, force: State, tangent: Tangent, tolerance: float) -> LinearSolution:
        top = self.system.topology
        inverses = np.linalg.inv(tangent.blocks[self._diagonal])
        if self._factor is None or self._last > 1.3 * self._fresh + 5:
            self._factor = factorised_coarse_tangent(
                top.coarsening, tangent.blocks, tangent.border, tangent.corner, self.interpolation
            )
            self._fresh = 0
        cycle = TwoLevel(
            top.pattern, tangent.blocks, tangent.border, inverses, self.interpolation, self._factor
        )
        solved = conjugate_gradients(cycle, tangent.corner, force.u, force.travel, tolerance)
        self._last = solved.iterations
        self._fresh = self._fresh or solved.iterations
        return solved

    def _downhill(self, force: State, tangent: Tangent) -> State:
        """Return a steepest-descent step, scaled by the stiffness of each node."""
        stiffness = np.abs(tangent.blocks[self._diagonal]).sum(axis=2)
        return State(-force.u / stiffness, -force.travel / max(tangent.corner, 1.0))

    def _searched(self, state: State, step: State, force: State, force_n: float) -> State | None:
        """Return the state after a backtracking line search (Armijo), or None."""
        energy = self.system.energy(state, force_n)
        slope = float((force.u * step.u).sum()) + force.travel * step.travel
        fraction = 1.0
        for _ in range(25):
            trial = state.plus(step, fraction)
            trial_energy = self.system.energy(trial, force_n)
            if trial_energy <= energy + 1e-4 * fraction * slope + ENERGY_SLACK * abs(energy):
                return trial
            fraction *= 0.5
        return None
