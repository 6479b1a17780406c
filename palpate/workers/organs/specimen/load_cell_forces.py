"""Predicted readings of load cells: forces that hold regions, as extra nodes after the mesh."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.diagnosis.problem.forward import Tetrahedra
from palpate.workers.mechanics.fem.equilibrium.sensitivity import reactions, tangents_with_reactions
from palpate.workers.mechanics.fem.equilibrium.solve import Equilibrium
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.fem.problem.outcome import Solution
from palpate.workers.mechanics.fem.problem.regions import nodes_in
from palpate.workers.organs.specimen.load_cells import LoadCell


@dataclass(frozen=True, eq=False)
class EquilibriumWithCells:
    """An equilibrium whose solution has an extra node for each load cell."""

    at: Equilibrium
    solution: Solution

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.at.problem


class TetrahedraWithCells(Tetrahedra):
    """Forward model of a body with load cells as extra nodes after the mesh.

    See `workers.diagnosis.problem.forward.Forward`.

    Parameters
    ----------
    cells : sequence of LoadCell
    """

    def __init__(self, cells: Sequence[LoadCell]) -> None:
        self.cells = tuple(cells)

    def equilibrium(self, model: Any, problem: Any, start: Any = None) -> EquilibriumWithCells:
        """See `Forward.equilibrium`."""
        begun = start.at if isinstance(start, EquilibriumWithCells) else start
        at = super().equilibrium(model, problem, begun)
        solution, held = at.solution, np.zeros((1, *at.solution.displacement_mm.shape))
        if solution.outcome.converged:
            held = reactions(at)[None]
        nodes = np.concatenate([solution.displacement_mm, self._read(at, held)[0]])
        return EquilibriumWithCells(at, replace(solution, displacement_mm=nodes))

    def expecting(self, at: Any, moved_mm: FloatArray) -> Any:
        """See `Forward.expecting`."""
        return super().expecting(at.at, moved_mm[: len(moved_mm) - len(self.cells)])

    def tangents(self, at: Any, changes: Sequence[Change], tolerance: float) -> FloatArray:
        """See `Forward.tangents`."""
        moved, forces = tangents_with_reactions(at.at, changes, tolerance)
        return np.concatenate([moved, self._read(at.at, forces)], axis=1)

    def pressed(self, at: Any) -> BoolArray | None:
        """See `Forward.pressed`."""
        return super().pressed(at.at)

    def _read(self, at: Equilibrium, forces: FloatArray) -> FloatArray:
        """Return readings of the cells in mm, (b, c, 3), from forces on the nodes, (b, n, 3)."""
        found, level = np.zeros((len(forces), len(self.cells), 3)), at.levels[-1].model
        for number, cell in enumerate(self.cells):
            inside = nodes_in(cell.region, level.nodes, level.edge_mm)
            found[:, number, cell.axis] = cell.mm_per_n * forces[:, inside, cell.axis].sum(axis=1)
        return found
