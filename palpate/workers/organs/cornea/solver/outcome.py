"""The outcome of a cornea's simulation in the form recorded by a study."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.problem.outcome import SQUEEZED_J
from palpate.workers.organs.cornea.solver.solve import CorneaSolution


@dataclass(frozen=True, eq=False)
class CorneaOutcome:
    """A solution with the interfaces `Solution` and `Outcome` of `workers.organs.organ`.

    Parameters
    ----------
    solution : CorneaSolution
    """

    solution: CorneaSolution

    @property
    def displacement_mm(self) -> FloatArray:
        """Return the displacement of the nodes, shape (n, 2)."""
        return self.solution.displacement_mm

    @property
    def outcome(self) -> "CorneaOutcome":
        """Return this object, which is also the outcome."""
        return self

    @property
    def converged(self) -> bool:
        """Return True if the displacement is in equilibrium with the full load."""
        return self.solution.converged

    @property
    def reason(self) -> str:
        """Return the reason for divergence; empty if converged."""
        return self.solution.reason

    def as_dict(self) -> dict[str, Any]:
        """Return the outcome as plain values, units in their names."""
        s = self.solution
        return {
            "converged": s.converged,
            "apex_displacement_um": s.apex_displacement_um,
            "jet_fraction": s.jet_fraction,
            "min_j": s.min_j if np.isfinite(s.min_j) else None,
            "squeezed": bool(s.converged and s.min_j < SQUEEZED_J),
            "stable": s.stable,
            "load_steps": s.load_steps,
            "cuts": s.cuts,
            "prestress_iterations": s.prestress_iterations,
            "newton_iterations": [s.newton_iterations],
            "factorisations": s.factorisations,
        }
