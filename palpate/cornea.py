"""The forward model of a cornea under the pressure of the eye and an air jet."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.service.simulation.organ_simulation import OrganModel, case_from_keys, stated_constants
from palpate.storage.read_only import ReadOnly, read_only
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.organs.cornea.cornea_forward import LoadedCornea
from palpate.workers.organs.cornea.prestressed_equilibrium import CorneaOutcome
from palpate.workers.organs.cornea.section_outline import Section

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Cornea", "CorneaSimulation"]


@dataclass(frozen=True, eq=False)
class CorneaSimulation(ReadOnly):
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
    deformed : Section
        Both surfaces after deformation, ``anterior_mm`` and ``posterior_mm``.
    """

    constants: Mapping[str, float]
    converged: bool
    reason: str
    nodes_mm: FloatArray
    triangles: IntArray
    displacement_mm: FloatArray
    outcome: Mapping[str, Any]
    deformed: Section
    _model: OrganModel = field(repr=False)
    _loaded: LoadedCornea = field(repr=False)

    def __repr__(self) -> str:
        size = f"{len(self.nodes_mm)} nodes, {len(self.triangles)} triangles"
        apex = f"apex {self.apex_displacement_um:.4g} um"
        return f"<CorneaSimulation of {size}: {apex if self.converged else self.reason}>"

    @property
    def apex_displacement_um(self) -> float:
        """Displacement of the apex into the eye, in um."""
        return float(self.outcome["apex_displacement_um"])

    @property
    def deformation_gradient(self) -> FloatArray:
        """F at each point, relative to the stress-free state if the model has one.

        Shape (m, q, 3, 3); the third axis is normal to the section. With the additive prestress,
        F is measured from the image.
        """
        return read_only(self._loaded.fields[0])

    @property
    def cauchy_stress_mpa(self) -> FloatArray:
        """Cauchy stress at each point in MPa, shape (m, q, 3, 3), tension positive."""
        return read_only(self._loaded.fields[1])

    def gradient(self, name: str) -> FloatArray:
        """Differentiate the displacement with respect to a constant.

        Parameters
        ----------
        name : str
            Name in a study file, such as ``"mu1_pa"``.

        Returns
        -------
        ndarray, shape (n, 2)
            Derivative in mm per unit of the constant, such as mm per Pa.

        Raises
        ------
        InputError
            If the constant is unknown, or the simulation did not converge.
        """
        return self._loaded.gradient(self._model.case.vocabulary.at_door(name))


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
        self._model = OrganModel(case_from_keys("cornea", keys))
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
        model = self._model
        values = model.case.complete(stated_constants(model.case, constants))
        outcome: Mapping[str, Any]
        if client is not None:
            displacement_mm, result = model.solve_on(client, constants, store)
            outcome, reason = result["outcome"], result["reason"]
        loaded: Any = LoadedCornea(model.model, model.case, values, model.landmarks)
        if client is None:
            solution = loaded.equilibrium.solution
            displacement_mm, reason = solution.displacement_mm, solution.reason
            outcome = CorneaOutcome(solution).as_dict()
        deformed = model.organ.deform(model.body, model.mesh, displacement_mm)
        return CorneaSimulation(
            constants=model.case.vocabulary.to_door(values),
            converged=bool(outcome["converged"]),
            reason=reason,
            nodes_mm=model.mesh.nodes_mm,
            triangles=model.mesh.triangles,
            displacement_mm=displacement_mm,
            outcome=outcome,
            deformed=Section(read_only(deformed.anterior_mm), read_only(deformed.posterior_mm)),
            _model=model,
            _loaded=loaded,
        )
