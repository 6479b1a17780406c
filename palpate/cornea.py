"""The forward model of a cornea under the pressure of the eye and an air jet."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.service.simulation.organ_simulation import OrganModel, case_from_keys
from palpate.service.simulation.simulation_record import SimulationRecord, Values
from palpate.storage.errors import InputError
from palpate.storage.read_only import read_only
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.fem.boundary_value_problem import Change
from palpate.workers.mechanics.model_parameters import Parameter
from palpate.workers.organs.cornea.cornea_forward import deformation_and_stress
from palpate.workers.organs.cornea.cornea_problem import Candidate, MeshForModels
from palpate.workers.organs.cornea.prestressed_equilibrium import (
    CandidateChange,
    CorneaOutcome,
    CorneaSolution,
    Equilibrium,
    equilibrium,
    sensitivity,
)
from palpate.workers.organs.cornea.section_outline import Section

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Cornea", "CorneaSimulation"]

# Difference step of a constant: relative to its value, or to its interval if it can be zero.
CONSTANT_STEP = 1e-5


@dataclass(frozen=True, eq=False, repr=False)
class CorneaSimulation(SimulationRecord):
    """One simulation of a section with n nodes and m six-node triangles of q points each.

    A simulation that does not converge is an ordinary result: `converged` is False, `reason`
    explains it, and the arrays describe the last equilibrium state. All arrays are read-only.

    Parameters
    ----------
    constants : mapping of str to float
        Every constant of the model, by its name in a study file.
    converged : bool
    reason : str
        Why it did not converge; empty when it did.
    nodes_mm : ndarray, shape (n, 2)
        Undeformed nodes (x, y) as imaged.
    triangles : ndarray of int32, shape (m, 6)
        Corners, then the midpoints of the sides.
    displacement_mm : ndarray, shape (n, 2)
    outcome : mapping of str to object
        Iterations, apex displacement and other figures reported by the solver.
    """

    triangles: IntArray

    @property
    def apex_displacement_um(self) -> float:
        """Displacement of the apex into the eye, in um."""
        return float(self.outcome["apex_displacement_um"])

    @cached_property
    def deformed(self) -> Section:
        """Both surfaces after deformation, ``anterior_mm`` and ``posterior_mm``."""
        deform: Any = self._loaded.deform
        section: Section = deform(self.displacement_mm)
        return Section(read_only(section.anterior_mm), read_only(section.posterior_mm))

    @property
    def deformation_gradient(self) -> FloatArray:
        """F at each point, relative to the stress-free state if the model has one.

        Shape (m, q, 3, 3); the third axis is normal to the section. With the additive prestress,
        F is measured from the image.
        """
        return self._fields[0]

    @property
    def cauchy_stress_mpa(self) -> FloatArray:
        """Cauchy stress at each point in MPa, shape (m, q, 3, 3), tension positive."""
        return self._fields[1]

    @staticmethod
    def _solve(model: MeshForModels, problem: Candidate) -> Equilibrium:
        return equilibrium(problem.prepared, problem.constants, problem.load)

    @staticmethod
    def _solution(solved: Equilibrium) -> CorneaOutcome:
        return CorneaOutcome(solved.solution)

    @staticmethod
    def _mesh(model: MeshForModels) -> dict[str, Any]:
        return {"nodes_mm": model.mesh.nodes_mm, "triangles": model.mesh.triangles}

    def _problem_with(self, others: Mapping[str, float]) -> Any:
        # The values are not completed again, which could exchange terms of the law.
        return self._loaded.problem({**self._values, **others})

    def _step(self, parameter: Parameter, value: float) -> float:
        return CONSTANT_STEP * (value or parameter.upper - parameter.lower)

    def _slope(self, parameter: Parameter, change: Change) -> FloatArray:
        solution = self._equilibrium.solution
        if not solution.converged:
            raise InputError(
                "Only an equilibrium has derivatives; this simulation did not converge: "
                f"{solution.reason}."
            )
        plus: Any = change.plus
        minus: Any = change.minus
        if minus is self._problem:  # at a bound, beyond which the model has other unknowns
            ahead: CorneaSolution = self._solve(self._loaded.model, plus).solution
            return (ahead.displacement_mm - solution.displacement_mm) / change.step
        step = self._step(parameter, self._values[parameter.name])
        pair = CandidateChange(plus, minus, step)
        return sensitivity(self._problem, [pair], self._equilibrium).derivatives[0]

    @property
    def _exported(self) -> tuple[Values, Values]:
        stress = {"cauchy_mpa": self.cauchy_stress_mpa.mean(axis=1)}
        return {"displacement_mm": self.displacement_mm}, stress

    @property
    def _motion(self) -> str:
        return f"apex {self.apex_displacement_um:.4g} um"

    @cached_property
    def _fields(self) -> tuple[FloatArray, FloatArray]:
        return read_only(deformation_and_stress(self._equilibrium))


class Cornea:
    """A section of a cornea, ready to be simulated with any constants.

    Parameters
    ----------
    anyway : bool
        Simulate even though the section or the load looks implausible.
    **keys
        Keys below ``case`` in a study file, without the name of their section: ``section`` or
        ``frame``; ``elements``; ``kind``, ``convention``, ``prestress``, ``order_terms_by``;
        ``iop_mmhg``, ``jet``; and held constants, such as ``mu1_pa=80``. The defaults are the same
        as in a study.

    Raises
    ------
    InputError
        If a key is not valid or the section cannot be simulated; the message lists every reason.

    Examples
    --------
    >>> model = Cornea(elements=200, iop_mmhg=15)
    >>> result = model.simulate()
    >>> result.converged, result.apex_displacement_um > 0
    (True, True)
    """

    def __init__(self, *, anyway: bool = False, **keys: Any) -> None:
        self._model = OrganModel(case_from_keys("cornea", keys), CorneaSimulation)
        for finding in self._model.check(anyway=anyway):
            warnings.warn(finding.text, stacklevel=2)

    @property
    def case(self) -> Any:
        """The case as in a study file, including defaults."""
        return self._model.case

    def simulate(
        self,
        *,
        client: "Client | None" = None,
        store: str | Path = "runs/store",
        **constants: float,
    ) -> CorneaSimulation:
        """Load the section once.

        Parameters
        ----------
        client : distributed.Client, optional
            A client with workers for the simulation. Default: this process. Results are stored and
            reused; stress and derivatives are computed here on request.
        store : str or Path
            Where the workers of `client` save the result: a folder, or ``s3://``, ``gs://`` or
            ``az://BUCKET/PREFIX``, visible to this process and all workers. Not used without a
            client.
        **constants : float
            Names and units of a study file, such as ``mu1_pa=80``; ``parameters("cornea")`` lists
            them. Other constants keep the values of the model.

        Raises
        ------
        InputError
            If a constant is unknown or its value is not admissible.
        """
        result: CorneaSimulation = self._model.simulate(constants, client, store)
        return result
