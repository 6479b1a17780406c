"""The result of one simulation of a sheet, as arrays."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.service.simulation.simulation_record import SimulationRecord, Values
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.fem.boundary_value_problem import Change
from palpate.workers.mechanics.model_parameters import Parameter
from palpate.workers.mechanics.sheet_equilibrium import equilibrium
from palpate.workers.mechanics.sheet_mesh import SheetModel


@dataclass(frozen=True, eq=False, repr=False)
class SheetSimulation(SimulationRecord):
    """One simulation of a sheet of n nodes and m triangles; all arrays are read-only.

    Parameters
    ----------
    constants : mapping of str to float
        Every constant of the model, by its name in an experiment.
    converged : bool
    reason : str
        Why it did not converge; empty when it did.
    nodes_mm : ndarray, shape (n, 3)
        Nodes at rest (x, y, z), at z = 0.
    triangles : ndarray of int32, shape (m, 6)
        Three corners and the midpoints of the edges 01, 12 and 20.
    displacement_mm : ndarray, shape (n, 3)
    outcome : mapping of str to object
        Iterations and other figures from the solver, with units in their names.
    """

    triangles: IntArray

    @property
    def thickness_mm(self) -> FloatArray:
        """Thickness of each triangle after deformation, shape (m,)."""
        stretch = self._equilibrium.response.thickness_stretch.reshape(-1, 3).mean(axis=1)
        return np.asarray(self._loaded.model.thickness_mm * stretch)

    @property
    def cauchy_stress_mpa(self) -> FloatArray:
        """Cauchy stress of each triangle in MPa, shape (m, 3, 3), tension positive."""
        return self._equilibrium.cauchy_stress_mpa

    @property
    def reaction_n(self) -> FloatArray:
        """Reaction forces in N at the held nodes, shape (n, 3)."""
        return self._equilibrium.reactions

    _solve = staticmethod(equilibrium)

    @staticmethod
    def _mesh(model: SheetModel) -> dict[str, Any]:
        return {"nodes_mm": model.nodes, "triangles": model.triangles}

    def _slope(self, parameter: Parameter, change: Change) -> FloatArray:
        slopes, _ = self._equilibrium.tangents([change])
        return np.asarray(slopes[0])

    @property
    def _exported(self) -> tuple[Values, Values]:
        cells = {"cauchy_mpa": self.cauchy_stress_mpa, "thickness_mm": self.thickness_mm}
        return {"displacement_mm": self.displacement_mm}, cells
