"""One simulation of a body of tetrahedra as arrays, with derivatives by the constants.

The derivative of a displacement with respect to a constant is shared with the simulation of a
sheet (`service.simulation.sheet_simulation`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from palpate.service.export.solved_mesh_files import MeshData, mesh_data
from palpate.storage.errors import InputError
from palpate.storage.read_only import ReadOnly, hold_read_only
from palpate.storage.stored_arrays import export_mesh
from palpate.storage.values import FloatArray, IntArray, TetMesh, Volume
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium, stress_free
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.mechanics.fem.element_energy import deformation_gradients
from palpate.workers.mechanics.fem.equilibrium_sensitivity import reactions, tangents
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.stress_fields import ElementFields, element_fields
from palpate.workers.mechanics.model_parameters import Parameter, Vocabulary

# Relative step of a constant: of its value, or of its interval if it can be zero.
GRADIENT_STEP = 1e-4
# The same for a constant with path-dependent solutions: friction saturates quickly.
PATH_GRADIENT_STEP = 0.02


def displacement_gradient(
    at: Equilibrium,
    problem_at: Callable[[float], Problem],
    parameter: Parameter,
    value: float,
    *,
    follows_path: bool = False,
) -> FloatArray:
    """Differentiate the displacement of an equilibrium with respect to one constant.

    Parameters
    ----------
    at : Equilibrium
    problem_at : callable
        Maps a value of the constant, in internal units, to the problem.
    parameter : Parameter
    value : float
        The constant at the equilibrium, in internal units.
    follows_path : bool
        Whether this constant, like friction, makes the solution depend on the load path. If so, the
        problem is solved again on both sides; otherwise a linear solve is enough.

    Returns
    -------
    ndarray, shape (n, 3)
        Derivative in mm per unit of the constant in study files, such as mm per kPa.

    Raises
    ------
    InputError
        If the simulation, or a nearby one, did not converge.
    """
    ahead, behind = either_side(
        parameter, value, PATH_GRADIENT_STEP if follows_path else GRADIENT_STEP
    )
    per_unit = parameter.unit.to_inside(1.0)
    if not follows_path:
        change = Change(problem_at(ahead), problem_at(behind), ahead - behind)
        moved: FloatArray = tangents(at, [change])[0]
        return moved * per_unit
    ends = [_displacement_nearby(at, problem_at(side), parameter) for side in (ahead, behind)]
    return (ends[0] - ends[1]) * (per_unit / (ahead - behind))


def either_side(parameter: Parameter, value: float, step: float) -> tuple[float, float]:
    """Return admissible values above and below a value, or the value itself at a bound.

    Examples
    --------
    >>> from palpate.workers.mechanics.model_parameters import BREAST
    >>> either_side(BREAST["E_fat"], 0.01, 0.5)
    (0.015, 0.005)
    """
    h = step * (value if parameter.lower > 0 else parameter.upper - parameter.lower)
    return _admissible(parameter, value + h, value), _admissible(parameter, value - h, value)


def _admissible(parameter: Parameter, wanted: float, otherwise: float) -> float:
    try:
        return parameter.check(wanted)
    except InputError:
        return otherwise


def _displacement_nearby(at: Equilibrium, problem: Problem, parameter: Parameter) -> FloatArray:
    solution = equilibrium(at.imaged, problem, at).solution
    if not solution.outcome.converged:
        raise InputError(
            f"The derivative with respect to {parameter.door_name} cannot be computed: a nearby "
            f"simulation diverged ({solution.outcome.reason})."
        )
    return solution.displacement_mm


@dataclass(frozen=True, eq=False)
class MeshedBody:
    """A body of tetrahedra and its model, ready for any constants.

    Parameters
    ----------
    model : Model
        The prepared mesh as imaged.
    vocabulary : Vocabulary
        The constants of the model.
    complete : callable
        Maps the given constants to all of them, in internal names and units.
    problem : callable
        Maps all constants to the problem.
    path_dependent : frozenset of str
        Constants that make the solution depend on the load path.
    deform : callable or None
        Maps a displacement, shape (n, 3), to the deformed body in voxels; None if the body has
        no voxels.
    """

    model: Model
    vocabulary: Vocabulary
    complete: Callable[[Mapping[str, float]], dict[str, float]]
    problem: Callable[[Mapping[str, float]], Problem]
    path_dependent: frozenset[str] = frozenset()
    deform: Callable[[FloatArray], Volume] | None = None

    def simulate(self, stated: Mapping[str, float]) -> "Simulation":
        """Load the body; failure to converge is an ordinary outcome.

        Parameters
        ----------
        stated : mapping of str to float
            Constants with internal names and units; missing ones take the values of `complete`.
        """
        solved = equilibrium(self.model, self.problem(self.complete(stated)))
        found = solved.solution
        return self.result(stated, found.displacement_mm, found.outcome.as_dict(), solved)

    def result(
        self,
        stated: Mapping[str, float],
        displacement_mm: FloatArray,
        outcome: Mapping[str, Any],
        solved: Equilibrium | None = None,
    ) -> "Simulation":
        """Return the result of a simulation with a known displacement, shape (n, 3)."""
        values = self.complete(stated)
        finest = self.model.finest
        return Simulation(
            constants=self.vocabulary.to_door(values),
            converged=bool(outcome["converged"]),
            reason=str(outcome["reason"]),
            nodes_mm=finest.nodes,
            tetrahedra=finest.elements.tets,
            tissue=finest.fractions.argmax(axis=1).astype(np.int32),
            displacement_mm=displacement_mm,
            outcome=outcome,
            _body=self,
            _stated=stated,
            _solved=solved,
        )


@dataclass(frozen=True, eq=False)
class Simulation(ReadOnly):
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

    constants: Mapping[str, float]
    converged: bool
    reason: str
    nodes_mm: FloatArray
    tetrahedra: IntArray
    tissue: IntArray
    displacement_mm: FloatArray
    outcome: Mapping[str, Any]
    _body: MeshedBody = field(repr=False)
    _stated: Mapping[str, float] = field(repr=False)
    _solved: Equilibrium | None = field(repr=False, default=None)

    def __repr__(self) -> str:
        size = f"{len(self.nodes_mm)} nodes, {len(self.tetrahedra)} tetrahedra"
        if not self.converged:
            return f"<Simulation of {size}: diverged: {self.reason[:80]}>"
        farthest_mm = np.linalg.norm(self.displacement_mm, axis=1).max()
        return f"<Simulation of {size}: moved by up to {farthest_mm:.3g} mm>"

    @property
    def deformed_nodes_mm(self) -> FloatArray:
        """Nodes after deformation, shape (n, 3)."""
        return self.nodes_mm + self.displacement_mm

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
        if self._body.deform is None:
            raise InputError("This body is not made of voxels: use deformed_nodes_mm.")
        if not self.converged:
            raise InputError(
                f"There is no deformed body because the simulation diverged: {self.reason}."
            )
        # Code would be compiled again for an array that is read-only.
        return self._body.deform(self.displacement_mm.copy())

    def gradient(self, name: str) -> FloatArray:
        """Differentiate the displacement with respect to a constant.

        A constant that follows this one unless it is set, as ``E_muscle_kpa`` follows
        ``E_fat_kpa``, changes with it. With friction, the slip of earlier load steps is held.

        Parameters
        ----------
        name : str
            Name in a study file, such as ``"E_fat_kpa"``.

        Returns
        -------
        ndarray, shape (n, 3)
            Derivative in mm per unit of the constant, such as mm per kPa.

        Raises
        ------
        InputError
            If the constant is unknown, or the simulation did not converge.
        """
        parameter = self._body.vocabulary.at_door(name)

        def problem_at(value: float) -> Problem:
            stated = {**self._stated, parameter.name: value}
            return self._body.problem(self._body.complete(stated))

        return displacement_gradient(
            self._equilibrium,
            problem_at,
            parameter,
            self._body.complete(self._stated)[parameter.name],
            follows_path=parameter.name in self._body.path_dependent,
        )

    def to_meshio(self) -> meshio.Mesh:
        """Return the deformed mesh with displacement, stress and strain as a `meshio.Mesh`.

        It has the same values as a ``.vtu`` file of ``palpate export``.
        """
        data = self._mesh_data
        return meshio.Mesh(
            data.mesh.nodes,
            [("tetra", data.mesh.tets.copy())],
            point_data={name: values.copy() for name, values in data.points.items()},
            cell_data={name: [values.copy()] for name, values in data.cells.items()},
        )

    def to_vtu(self, path: str | Path) -> Path:
        """Write the mesh of `to_meshio` for ParaView; .vtk and .msh work as well.

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

    @cached_property
    def _equilibrium(self) -> Equilibrium:
        """The state of the solver; recomputed if the simulation ran elsewhere."""
        if self._solved is not None:
            return self._solved
        return equilibrium(self._body.model, self._body.problem(self._body.complete(self._stated)))

    @cached_property
    def _level(self) -> Level:
        if self._solved is not None:
            return self._solved.levels[-1]
        model, problem = self._body.model, self._body.problem(self._body.complete(self._stated))
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
