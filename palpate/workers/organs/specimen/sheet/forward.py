"""Forward model of a sheet, with load cells as extra nodes after the mesh."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.fem.problem.regions import nodes_in
from palpate.workers.mechanics.sheet.solve import SheetEquilibrium, SheetSolution, equilibrium
from palpate.workers.organs.specimen.load_cells import LoadCell


@dataclass(frozen=True, eq=False)
class SheetWithCells:
    """An equilibrium whose solution has an extra node for each load cell.

    Parameters
    ----------
    at : SheetEquilibrium
    solution : SheetSolution
    expected_mm : ndarray, shape (n, 3)
        Expected displacements of the nodes in a similar problem.
    """

    at: SheetEquilibrium
    solution: SheetSolution
    expected_mm: FloatArray

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.at.problem


class SheetForward:
    """Forward model of a sheet; see `workers.diagnosis.problem.forward.Forward`.

    Parameters
    ----------
    cells : sequence of LoadCell
    """

    def __init__(self, cells: Sequence[LoadCell]) -> None:
        self.cells = tuple(cells)

    def equilibrium(self, model: Any, problem: Any, start: Any = None) -> SheetWithCells:
        """See `Forward.equilibrium`."""
        at = equilibrium(model, problem, None if start is None else start.expected_mm)
        u = at.solution.displacement_mm
        forces = at.reactions if at.solution.outcome.converged else np.zeros_like(u)
        nodes = np.concatenate([u, self._read(at, forces[None])[0]])
        return SheetWithCells(at, replace(at.solution, displacement_mm=nodes), u)

    def expecting(self, at: SheetWithCells, moved_mm: FloatArray) -> SheetWithCells:
        """See `Forward.expecting`."""
        own = len(at.expected_mm)
        expected = at.at.solution.displacement_mm + moved_mm[:own]
        return replace(at, expected_mm=expected)

    def tangents(self, at: SheetWithCells, changes: Sequence[Change], tolerance: float) -> Any:
        """See `Forward.tangents`; the solves are exact."""
        moved, forces = at.at.tangents(changes)
        return np.concatenate([moved, self._read(at.at, forces)], axis=1)

    def loosened(self, problem: Problem, tolerance_mm: float, friction_steps: int) -> Problem:
        """Return the problem unchanged, because it is cheap to solve."""
        return problem

    def direction(self, problem: Problem) -> Sequence[float]:
        """See `Forward.direction`."""
        axis: Sequence[float] = problem.load.device.axis
        return axis

    def pressed(self, at: SheetWithCells) -> None:
        """Return None: there are no plates."""

    def _read(self, at: SheetEquilibrium, forces: FloatArray) -> FloatArray:
        """Return readings of the cells in mm, (b, c, 3), from forces on the nodes, (b, n, 3)."""
        found, model = np.zeros((len(forces), len(self.cells), 3)), at.system.model
        for number, cell in enumerate(self.cells):
            inside = nodes_in(cell.region, model.nodes, model.edge_mm)
            found[:, number, cell.axis] = cell.mm_per_n * forces[:, inside, cell.axis].sum(axis=1)
        return found
