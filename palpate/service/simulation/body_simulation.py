"""The result of one simulation of a body of tetrahedra, as arrays."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from palpate.service.export.exported_mesh import export_mesh
from palpate.service.export.solved_mesh_files import MeshData, mesh_data
from palpate.service.simulation.simulation_record import SimulationRecord, Values
from palpate.storage.errors import InputError
from palpate.storage.read_only import hold_read_only
from palpate.storage.values import FloatArray, IntArray, TetMesh, Volume
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium, stress_free
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.mechanics.fem.element_energy import deformation_gradients
from palpate.workers.mechanics.fem.equilibrium_sensitivity import reactions, tangents
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.stress_fields import ElementFields, element_fields
from palpate.workers.mechanics.model_parameters import Parameter


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(SimulationRecord):
    """One simulation of a body of n nodes and m linear tetrahedra.

    A simulation that does not converge is an ordinary result: `converged` is False, `reason`
    explains it, and the arrays describe the last state reached. Strain and stress refer to the
    stress-free shape, which is `nodes_mm` unless gravity acts in the image. All arrays are
    read-only.

    Parameters
    ----------
    constants : mapping of str to float
        Every constant of the model, by its name in a study file.
    converged : bool
    reason : str
        Why it did not converge; empty when it did.
    nodes_mm : ndarray, shape (n, 3)
        Undeformed nodes (x, y, z) as imaged.
    tetrahedra : ndarray of int32, shape (m, 4)
        Nodes of each element.
    tissue : ndarray of int32, shape (m,)
        `Tissue` of each element.
    displacement_mm : ndarray, shape (n, 3)
    outcome : mapping of str to object
        Iterations, residual, contact area and other figures from the solver; names contain units.
    """

    tetrahedra: IntArray
    tissue: IntArray

    _elements: ClassVar[str] = "tetrahedra"
    _meshio_name: ClassVar[str] = "tetra"

    @property
    def deformation_gradient(self) -> FloatArray:
        """F of each tetrahedron, shape (m, 3, 3)."""
        elements = self._level.model.elements
        found: FloatArray = deformation_gradients(self.deformed_nodes_mm, elements)
        return found

    @property
    def green_lagrange_strain(self) -> FloatArray:
        """E = (F^T F - 1) / 2 of each tetrahedron, shape (m, 3, 3)."""
        return self._fields.green_strain

    @property
    def cauchy_stress_mpa(self) -> FloatArray:
        """Cauchy stress of each tetrahedron in MPa, shape (m, 3, 3), tension positive."""
        return self._fields.cauchy_mpa

    @property
    def von_mises_mpa(self) -> FloatArray:
        """Von Mises stress of each tetrahedron in MPa, shape (m,)."""
        return self._fields.von_mises_mpa

    @property
    def volume_ratio(self) -> FloatArray:
        """J of each tetrahedron, shape (m,)."""
        return self._fields.volume_ratio

    @property
    def plate_force_n(self) -> float:
        """Force on the upper plate in N; zero without plates."""
        return float(self.outcome["plate_force_n"])

    @property
    def plate_travel_mm(self) -> float:
        """Closure of the plates since they touched the body, in mm."""
        return float(self.outcome["plate_displacement_mm"])

    @property
    def reaction_n(self) -> FloatArray:
        """Reaction forces in N at nodes held by a wall or a hold, shape (n, 3)."""
        return reactions(self._equilibrium)

    @cached_property
    def deformed(self) -> Volume:
        """The deformed body as labelled voxels.

        Raises
        ------
        InputError
            If the body has no voxels, or the simulation did not converge.
        """
        if self._loaded.deform is None:
            raise InputError("This body is not made of voxels: use deformed_nodes_mm.")
        if not self.converged:
            raise InputError(
                f"There is no deformed body because the simulation diverged: {self.reason}."
            )
        # Code would be compiled again for an array that is read-only.
        deformed: Volume = self._loaded.deform(self.displacement_mm.copy())
        return deformed

    def to_vtu(self, path: str | Path) -> Path:
        """Write the mesh of `to_meshio` for ParaView; .vtk and .msh work as well.

        It has the same values as a ``.vtu`` file of ``palpate export``.

        Raises
        ------
        InputError
            If the suffix is not supported.
        StoreError
            If the file cannot be written.
        """
        data = self._mesh_data
        export_mesh(path, data.mesh, data.points, data.cells)
        return Path(path)

    def to_pyvista(self) -> Any:
        """Return the mesh of `to_meshio` as a `pyvista.UnstructuredGrid`.

        Raises
        ------
        InputError
            If pyvista is not installed.
        """
        try:
            import pyvista
        except ImportError:
            raise InputError(
                "to_pyvista needs pyvista, which is not installed: pip install 'palpate[pyvista]'."
            ) from None
        return pyvista.from_meshio(self.to_meshio())

    _solve = staticmethod(equilibrium)

    @staticmethod
    def _mesh(model: Model) -> dict[str, Any]:
        finest = model.finest
        tissue = finest.fractions.argmax(axis=1).astype(np.int32)
        return {"nodes_mm": finest.nodes, "tetrahedra": finest.elements.tets, "tissue": tissue}

    def _slope(self, parameter: Parameter, change: Change) -> FloatArray:
        if not self._loaded.follows_path(parameter.name):
            slope: FloatArray = tangents(self._equilibrium, [change])[0]
            return slope
        ends = [self._nearby(problem, parameter) for problem in (change.plus, change.minus)]
        return (ends[0] - ends[1]) * (1.0 / change.step)

    def _nearby(self, problem: Problem, parameter: Parameter) -> FloatArray:
        start: Equilibrium = self._equilibrium
        solution = equilibrium(start.imaged, problem, start).solution
        if not solution.outcome.converged:
            raise InputError(
                f"The derivative with respect to {parameter.door_name} cannot be computed: a "
                f"nearby simulation diverged ({solution.outcome.reason})."
            )
        return solution.displacement_mm

    @cached_property
    def _level(self) -> Level:
        if self._solved is not None:
            level: Level = self._solved.levels[-1]
            return level
        model, problem = self._loaded.model, self._problem
        if any(problem.imaged_gravity_g):
            model = stress_free(model, problem)
        return Level.build(model.finest, problem)

    @cached_property
    def _fields(self) -> ElementFields:
        fields = element_fields(self._level, self.deformed_nodes_mm)
        hold_read_only(fields)
        return fields

    @property
    def _mesh_data(self) -> MeshData:
        deformed = TetMesh(self.deformed_nodes_mm, self.tetrahedra)
        return mesh_data(deformed, self.displacement_mm, self.tissue, self._fields)

    @property
    def _exported(self) -> tuple[Values, Values]:
        data = self._mesh_data
        return data.points, data.cells
