"""One simulation as arrays, with derivatives by the constants; and a loaded model that makes it.

Bodies of tetrahedra, sheets and corneas differ in their mesh, their solver and their stresses.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Generic, TypeVar

import meshio
import numpy as np
from numpy.typing import NDArray

from palpate.storage.read_only import ReadOnly
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.boundary_value_problem import Change
from palpate.workers.mechanics.model_parameters import Parameter, Vocabulary

# Relative step of a constant: of its value, or of its interval if it can be zero.
GRADIENT_STEP = 1e-4
# The same for a constant with path-dependent solutions: friction saturates quickly.
PATH_GRADIENT_STEP = 0.02

R = TypeVar("R", bound="SimulationRecord")
Values = Mapping[str, NDArray[Any]]


def never(name: str) -> bool:
    """Return False: no constant makes the solution depend on the load path."""
    return False


@dataclass(frozen=True, eq=False)
class LoadedModel(Generic[R]):
    """A model under load, ready for any constants.

    Parameters
    ----------
    kind : type
        Class of its simulations.
    model : object
        The mesh as imaged, prepared for the solver.
    vocabulary : Vocabulary
        The constants of the model.
    complete : callable
        Maps the given constants to all of them, in internal names and units.
    problem : callable
        Maps all constants to the problem.
    follows_path : callable
        Whether a constant, like friction, makes the solution depend on the load path.
    deform : callable or None
        Maps a displacement of the nodes to the deformed body; None if there is only a mesh.
    """

    kind: type[R]
    model: Any
    vocabulary: Vocabulary
    complete: Callable[[Mapping[str, float]], dict[str, float]]
    problem: Callable[[Mapping[str, float]], Any]
    follows_path: Callable[[str], bool] = never
    deform: Callable[[FloatArray], Any] | None = None

    def simulate(self, stated: Mapping[str, float]) -> R:
        """Load the model; failure to converge is an ordinary outcome.

        Parameters
        ----------
        stated : mapping of str to float
            Constants with internal names and units; missing ones take the values of `complete`.
        """
        solved = self.kind._solve(self.model, self.problem(self.complete(stated)))
        solution = self.kind._solution(solved)
        outcome = solution.outcome
        return self.result(
            stated, solution.displacement_mm, outcome.reason, outcome.as_dict(), solved
        )

    def result(
        self,
        stated: Mapping[str, float],
        displacement_mm: FloatArray,
        reason: str,
        outcome: Mapping[str, Any],
        solved: Any = None,
    ) -> R:
        """Return the result of a simulation with a known displacement of the nodes."""
        return self.kind(
            constants=self.vocabulary.to_door(self.complete(stated)),
            converged=bool(outcome["converged"]),
            reason=reason,
            displacement_mm=displacement_mm,
            outcome=outcome,
            _loaded=self,
            _stated=stated,
            _solved=solved,
            **self.kind._mesh(self.model),
        )


@dataclass(frozen=True, eq=False)
class SimulationRecord(ReadOnly):
    """What every simulation of a mesh with n nodes has; all arrays are read-only.

    A subclass adds the elements of its mesh, whose attribute `_elements` names, and the values
    in them.
    """

    constants: Mapping[str, float]
    converged: bool
    reason: str
    nodes_mm: FloatArray
    displacement_mm: FloatArray
    outcome: Mapping[str, Any]
    _loaded: LoadedModel[Any] = field(repr=False, kw_only=True)
    _stated: Mapping[str, float] = field(repr=False, kw_only=True)
    _solved: Any = field(repr=False, kw_only=True, default=None)

    _elements: ClassVar[str] = "triangles"
    _meshio_name: ClassVar[str] = "triangle6"

    def __repr__(self) -> str:
        size = f"{len(self.nodes_mm)} nodes, {len(getattr(self, self._elements))} {self._elements}"
        motion = self._motion if self.converged else f"diverged: {self.reason[:80]}"
        return f"<{type(self).__name__} of {size}: {motion}>"

    @property
    def deformed_nodes_mm(self) -> FloatArray:
        """Nodes after deformation, in the shape of `nodes_mm`."""
        return self.nodes_mm + self.displacement_mm

    def gradient(self, name: str) -> FloatArray:
        """Differentiate the displacement with respect to a constant.

        A constant that follows this one unless it is set, as ``E_muscle_kpa`` follows
        ``E_fat_kpa``, changes with it. With friction, the slip of earlier load steps is held.

        Parameters
        ----------
        name : str
            Name in a study file or an experiment, such as ``"E_fat_kpa"``.

        Returns
        -------
        ndarray, in the shape of `displacement_mm`
            Derivative in mm per unit of the constant, such as mm per kPa.

        Raises
        ------
        InputError
            If the constant is unknown, or the simulation did not converge.
        """
        parameter = self._loaded.vocabulary.at_door(name)
        value = self._values[parameter.name]
        ahead, behind = parameter.either_side(value, self._step(parameter, value))
        plus, minus = (
            self._problem if side == value else self._problem_with({parameter.name: side})
            for side in (ahead, behind)
        )
        slope = self._slope(parameter, Change(plus, minus, ahead - behind))
        return np.asarray(slope * parameter.unit.to_inside(1.0))

    def to_meshio(self) -> meshio.Mesh:
        """Return the deformed mesh, with displacement, stress and more, as a `meshio.Mesh`."""
        points, cells = self._exported
        return meshio.Mesh(
            self.deformed_nodes_mm,
            [(self._meshio_name, getattr(self, self._elements).copy())],
            point_data={name: values.copy() for name, values in points.items()},
            cell_data={name: [values.copy()] for name, values in cells.items()},
        )

    @staticmethod
    def _solve(model: Any, problem: Any) -> Any:
        """Return the state of the solver at the end of the load."""
        raise NotImplementedError

    @staticmethod
    def _solution(solved: Any) -> Any:
        """Return displacement and outcome; see `workers.organs.organ_protocol.Solution`."""
        return solved.solution

    @staticmethod
    def _mesh(model: Any) -> dict[str, Any]:
        """Return nodes and elements by the names of the fields."""
        raise NotImplementedError

    def _step(self, parameter: Parameter, value: float) -> float:
        """Return the difference step of a constant."""
        share = PATH_GRADIENT_STEP if self._loaded.follows_path(parameter.name) else GRADIENT_STEP
        return share * (value if parameter.lower > 0 else parameter.upper - parameter.lower)

    def _slope(self, parameter: Parameter, change: Change) -> FloatArray:
        """Return the derivative of the displacement in mm per internal unit.

        A side of the change that is the simulation itself has the problem `_problem`.
        """
        raise NotImplementedError

    @property
    def _exported(self) -> tuple[Values, Values]:
        """Values at the nodes and in the elements that are written to files."""
        raise NotImplementedError

    @property
    def _motion(self) -> str:
        farthest_mm = np.linalg.norm(self.displacement_mm, axis=1).max()
        return f"moved by up to {farthest_mm:.3g} mm"

    @property
    def _values(self) -> dict[str, float]:
        return self._loaded.complete(self._stated)

    @cached_property
    def _problem(self) -> Any:
        return self._problem_with({})

    def _problem_with(self, others: Mapping[str, float]) -> Any:
        return self._loaded.problem(self._loaded.complete({**self._stated, **others}))

    @cached_property
    def _equilibrium(self) -> Any:
        """The state of the solver; recomputed if the simulation ran elsewhere."""
        if self._solved is not None:
            return self._solved
        return self._solve(self._loaded.model, self._problem)
