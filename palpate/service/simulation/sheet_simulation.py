"""The result of one simulation of a sheet, as arrays."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import meshio
import numpy as np

from palpate.service.simulation.body_simulation import GRADIENT_STEP, either_side
from palpate.storage.read_only import ReadOnly
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.model_parameters import Vocabulary
from palpate.workers.mechanics.sheet_equilibrium import SheetEquilibrium, equilibrium
from palpate.workers.mechanics.sheet_mesh import SheetModel


@dataclass(frozen=True, eq=False)
class LoadedSheet:
    """A sheet in one state, ready for any constants.

    Parameters
    ----------
    model : SheetModel
    vocabulary : Vocabulary
        The constants of the model.
    complete : callable
        Maps the given constants to all of them, in internal names and units.
    problem : callable
        Maps all constants to the problem.
    """

    model: SheetModel
    vocabulary: Vocabulary
    complete: Callable[[Mapping[str, float]], dict[str, float]]
    problem: Callable[[Mapping[str, float]], Problem]

    def solved(self, stated: Mapping[str, float]) -> SheetEquilibrium:
        """Return the equilibrium for the given constants."""
        return equilibrium(self.model, self.problem(self.complete(stated)))

    def simulate(self, stated: Mapping[str, float]) -> "SheetSimulation":
        """Load the sheet; failure to converge is an ordinary outcome.

        Parameters
        ----------
        stated : mapping of str to float
            Constants with internal names and units.
        """
        at = self.solved(stated)
        found = at.solution
        return self.result(stated, found.displacement_mm, found.outcome.as_dict(), at)

    def result(
        self,
        stated: Mapping[str, float],
        displacement_mm: FloatArray,
        outcome: Mapping[str, Any],
        at: SheetEquilibrium | None = None,
    ) -> "SheetSimulation":
        """Return the result of a simulation with a known displacement, shape (n, 3)."""
        return SheetSimulation(
            constants=self.vocabulary.to_door(self.complete(stated)),
            converged=bool(outcome["converged"]),
            reason=str(outcome["reason"]),
            nodes_mm=self.model.nodes,
            triangles=self.model.triangles,
            displacement_mm=displacement_mm,
            outcome=outcome,
            _sheet=self,
            _stated=stated,
            _known=at,
        )


@dataclass(frozen=True, eq=False)
class SheetSimulation(ReadOnly):
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

    constants: Mapping[str, float]
    converged: bool
    reason: str
    nodes_mm: FloatArray
    triangles: IntArray
    displacement_mm: FloatArray
    outcome: Mapping[str, Any]
    _sheet: LoadedSheet = field(repr=False)
    _stated: Mapping[str, float] = field(repr=False)
    _known: SheetEquilibrium | None = field(repr=False, default=None)

    def __repr__(self) -> str:
        size = f"{len(self.nodes_mm)} nodes, {len(self.triangles)} triangles"
        if not self.converged:
            return f"<SheetSimulation of {size}: diverged: {self.reason[:80]}>"
        farthest_mm = np.linalg.norm(self.displacement_mm, axis=1).max()
        return f"<SheetSimulation of {size}: moved by up to {farthest_mm:.3g} mm>"

    @property
    def deformed_nodes_mm(self) -> FloatArray:
        """Nodes after deformation, shape (n, 3)."""
        return self.nodes_mm + self.displacement_mm

    @property
    def thickness_mm(self) -> FloatArray:
        """Thickness of each triangle after deformation, shape (m,)."""
        stretch = self._equilibrium.response.thickness_stretch.reshape(-1, 3).mean(axis=1)
        return np.asarray(self._sheet.model.thickness_mm * stretch)

    @property
    def cauchy_stress_mpa(self) -> FloatArray:
        """Cauchy stress of each triangle in MPa, shape (m, 3, 3), tension positive."""
        return self._equilibrium.cauchy_stress_mpa

    @property
    def reaction_n(self) -> FloatArray:
        """Reaction forces in N at the held nodes, shape (n, 3)."""
        return self._equilibrium.reactions

    def gradient(self, name: str) -> FloatArray:
        """Differentiate the displacement with respect to a constant.

        Parameters
        ----------
        name : str
            Name in an experiment, such as ``"E_kpa"``.

        Returns
        -------
        ndarray, shape (n, 3)
            Derivative in mm per unit of the constant, such as mm per kPa.

        Raises
        ------
        InputError
            If the constant is unknown, or the simulation did not converge.
        """
        parameter = self._sheet.vocabulary.at_door(name)
        values = self._sheet.complete(self._stated)
        ahead, behind = either_side(parameter, values[parameter.name], GRADIENT_STEP)
        plus, minus = (
            self._sheet.problem({**values, parameter.name: one}) for one in (ahead, behind)
        )
        moved, _ = self._equilibrium.tangents([Change(plus, minus, ahead - behind)])
        return np.asarray(moved[0] * parameter.unit.to_inside(1.0))

    def to_meshio(self) -> meshio.Mesh:
        """Return the deformed mesh with displacement, stress and thickness as a `meshio.Mesh`."""
        cells = {"cauchy_mpa": self.cauchy_stress_mpa, "thickness_mm": self.thickness_mm}
        return meshio.Mesh(
            self.deformed_nodes_mm,
            [("triangle6", self.triangles.copy())],
            point_data={"displacement_mm": self.displacement_mm.copy()},
            cell_data={name: [values] for name, values in cells.items()},
        )

    @cached_property
    def _equilibrium(self) -> SheetEquilibrium:
        """The state of the solver; recomputed if the simulation ran elsewhere."""
        return self._known or self._sheet.solved(self._stated)
