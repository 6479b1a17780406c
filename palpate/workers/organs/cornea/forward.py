"""One simulation of a cornea as arrays: displacement, strain, stress and derivatives."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.parameters import Parameter
from palpate.workers.organs.cornea.problem import candidate_of
from palpate.workers.organs.cornea.solver.candidate import Candidate
from palpate.workers.organs.cornea.solver.model_cache import MeshForModels
from palpate.workers.organs.cornea.solver.sensitivity import Change, sensitivity
from palpate.workers.organs.cornea.solver.solve import Equilibrium, equilibrium
from palpate.workers.organs.cornea.solver.t6_assembly import deformed_state
from palpate.workers.organs.cornea.spec import CorneaCase

# Difference step of a constant: relative to its value, or to its interval if it can be zero.
STEP = 1e-5


@dataclass(frozen=True, eq=False)
class LoadedCornea:
    """A section under the pressure of the eye and an air jet.

    Parameters
    ----------
    meshes : MeshForModels
    case : CorneaCase
    constants : mapping of str to float
        All constants, in internal names and units.
    middle_mm : float
        x of the middle of the section.
    """

    meshes: MeshForModels
    case: CorneaCase
    constants: Mapping[str, float]
    middle_mm: float

    @cached_property
    def candidate(self) -> Candidate:
        """Return the candidate."""
        return self._candidate(self.constants)

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """Return the solution with its equations."""
        at = self.candidate
        return equilibrium(at.prepared, at.constants, at.load)

    @cached_property
    def fields(self) -> tuple[FloatArray, FloatArray]:
        """Return the deformation gradient and the Cauchy stress in MPa.

        Both have the shape (m, q, 3, 3): m triangles, q points in each; the third axis is normal
        to the section. The gradient is relative to the configuration of the prestress.
        """
        at, u = self.equilibrium, self.equilibrium.solution.displacement_mm
        system = at.prestressed.system
        plane, third, stress = deformed_state(
            system.from_rest(u), system.elements, system.law, system.prepared.kind
        )
        F = np.zeros((*third.shape, 3, 3))
        F[..., :2, :2] = plane.reshape(*third.shape, 2, 2)
        F[..., 2, 2] = third
        S = np.zeros_like(F)
        S[..., 0, 0], S[..., 1, 1], S[..., 2, 2] = stress[..., 0], stress[..., 1], stress[..., 3]
        S[..., 0, 1] = S[..., 1, 0] = stress[..., 2]
        cauchy = F @ S @ F.swapaxes(-1, -2) / np.linalg.det(F)[..., None, None]
        return F, cauchy

    def gradient(self, parameter: Parameter) -> FloatArray:
        """Return the derivative of the displacement, shape (n, 2), in mm per external unit.

        Raises
        ------
        InputError
            If the simulation did not converge.
        """
        solution = self.equilibrium.solution
        if not solution.converged:
            raise InputError(
                "Only an equilibrium has derivatives; this simulation did not converge: "
                f"{solution.reason}."
            )
        value = self.constants[parameter.name]
        h = STEP * (value or parameter.upper - parameter.lower)
        per_unit = parameter.unit.to_inside(1.0)
        ahead = self._candidate({**self.constants, parameter.name: value + h})
        if _is_admissible(parameter, value - h):
            behind = self._candidate({**self.constants, parameter.name: value - h})
            change = Change(ahead, behind, h)
            found = sensitivity(self.candidate, [change], self.equilibrium).derivatives[0]
            return np.asarray(found * per_unit)
        moved = equilibrium(ahead.prepared, ahead.constants, ahead.load).solution
        return np.asarray((moved.displacement_mm - solution.displacement_mm) / h * per_unit)

    def _candidate(self, constants: Mapping[str, float]) -> Candidate:
        return candidate_of(self.meshes, self.case, constants, self.middle_mm)


def _is_admissible(parameter: Parameter, value: float) -> bool:
    try:
        parameter.check(value)
    except InputError:
        return False
    return True
