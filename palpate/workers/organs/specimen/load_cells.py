"""Load cells: forces by which a testing machine moves regions, as additional points of a fit.

A load cell is an additional point whose displacement is its reading, scaled so that its noise
equals the noise of a point of the field. Derivatives with respect to constants and effects
therefore include the forces. Load cells are placed far from the body and from each other, so that
no spatial correlation connects them. The forward models of tetrahedra and of sheets predict their
readings, the forces that hold regions, as extra nodes after the mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.diagnosis.problem.inverse_problem import FORCE, Tetrahedra
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem, Solution
from palpate.workers.mechanics.fem.equilibrium_sensitivity import reactions, tangents_with_reactions
from palpate.workers.mechanics.fem.loads_and_regions import Region, nodes_in
from palpate.workers.mechanics.sheet_equilibrium import SheetEquilibrium, SheetSolution, equilibrium
from palpate.workers.organs.specimen.specimen_keys import SpecimenSpec, StateSpec
from palpate.workers.organs.specimen.specimen_problem import AXES, region_of

# Spacing of load cells, far beyond any correlation length.
FAR_MM = 1e6


@dataclass(frozen=True, slots=True)
class LoadCell:
    """A load cell that holds a region along an axis and measures the force on the body.

    Parameters
    ----------
    region : Region
    axis : int
    mm_per_n : float
        Displacement that represents a force of 1 N.
    """

    region: Region
    axis: int
    mm_per_n: float


def load_cells(spec: SpecimenSpec, sd_mm: float) -> tuple[LoadCell, ...]:
    """Return the load cells of an experiment.

    Parameters
    ----------
    spec : SpecimenSpec
        Experiment whose states all have the same reactions.
    sd_mm : float
        Standard deviation of a component of a point, to which the noise of each cell is scaled.
    """
    sd_n = np.array([[one.sd_n for one in state.reactions] for state in spec.states])
    return tuple(
        LoadCell(region_of(spec.regions[one.region]), AXES.index(one.axis), float(sd_mm / sd))
        for one, sd in zip(spec.states[0].reactions, sd_n.mean(axis=0), strict=True)
    )


def readings_mm(state: StateSpec, cells: Sequence[LoadCell]) -> FloatArray:
    """Return the measured readings of a state as displacements, shape (c,)."""
    pairs = zip(state.reactions, cells, strict=True)
    return np.array([one.force_n * cell.mm_per_n for one, cell in pairs])


def with_load_cells(points: InterfacePoints, cells: Sequence[LoadCell]) -> InterfacePoints:
    """Add a point for each load cell, whose normal is the axis of the cell."""
    count = len(cells)
    away = FAR_MM * np.outer(1.0 + np.arange(count), [1.0, 0.0, 0.0])
    return InterfacePoints(
        np.concatenate([points.points, away]),
        np.concatenate([points.normals, np.eye(3)[[cell.axis for cell in cells]].reshape(-1, 3)]),
        np.concatenate([points.interface, np.full(count, FORCE, np.int32)]),
        np.concatenate([points.area_mm2, np.ones(count)]),
        np.concatenate([points.part, np.full(count, FORCE, np.int32)]),
    )


def covariance_with(
    covariance: FloatArray, spec: SpecimenSpec, cells: Sequence[LoadCell]
) -> FloatArray:
    """Return the covariance of points and load cells, state by state.

    Parameters
    ----------
    covariance : ndarray, shape (s k, s k)
        Covariance of k components of points in each of s states, in mm^2.
    spec : SpecimenSpec
    cells : sequence of LoadCell
        The c load cells; errors of their readings are independent.

    Returns
    -------
    ndarray, shape (s (k + c), s (k + c))
    """
    states = len(spec.states)
    variances = np.array(
        [
            [
                (reaction.sd_n * cell.mm_per_n) ** 2
                for reaction, cell in zip(s.reactions, cells, strict=True)
            ]
            for s in spec.states
        ]
    )
    number = np.arange(len(covariance)).reshape(states, -1)
    read = len(covariance) + np.arange(variances.size).reshape(states, -1)
    order = np.hstack([number, read]).ravel()
    whole = block_diag(covariance, np.diag(variances.ravel()))
    return np.asarray(whole[np.ix_(order, order)])


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

    See `workers.diagnosis.problem.inverse_problem.Forward`.

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
    """Forward model of a sheet; see `workers.diagnosis.problem.inverse_problem.Forward`.

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
