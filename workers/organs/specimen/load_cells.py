"""Forces that a testing machine needs to move a region, as further points that a fit compares.

A load cell is one more point, whose displacement is the force that it reads: the noise of its
reading counts as much as that of a point of the field. So whatever asks how constants and effects
move the points asks how they change the forces, too. Load cells lie far from the body and from
each other, so nothing that is smooth in space relates them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from storage.values import BoolArray, FloatArray
from workers.comparison.observation.interface import InterfacePoints
from workers.diagnosis.force_readings import FORCE
from workers.diagnosis.forward import Tetrahedra
from workers.mechanics.fem.outcome import Solution
from workers.mechanics.fem.problem import Problem
from workers.mechanics.fem.regions import Region, nodes_in
from workers.mechanics.fem.sensitivity import Change, reactions, tangents_with_reactions
from workers.mechanics.fem.solve import Equilibrium, equilibrium
from workers.organs.specimen.problem import AXES, region_of
from workers.organs.specimen.spec import SpecimenSpec, StateSpec

# Of load cells, times their number: no correlation length reaches so far.
FAR_MM = 1e6


@dataclass(frozen=True, slots=True)
class LoadCell:
    """What holds a region along an axis, and reads the force on the body.

    Parameters
    ----------
    region : Region
    axis : int
    mm_per_n : float
        Displacement that stands for a force.
    """

    region: Region
    axis: int
    mm_per_n: float


def load_cells(spec: SpecimenSpec, sd_mm: float) -> tuple[LoadCell, ...]:
    """Return the load cells of an experiment.

    Parameters
    ----------
    spec : SpecimenSpec
        All of whose states list the same reactions.
    sd_mm : float
        Of a component of a point: as much as the noise of a cell stands for.
    """
    sd_n = np.array([[one.sd_n for one in state.reactions] for state in spec.states])
    return tuple(
        LoadCell(region_of(spec.regions[one.region]), AXES.index(one.axis), float(sd_mm / sd))
        for one, sd in zip(spec.states[0].reactions, sd_n.mean(axis=0), strict=True)
    )


def readings_mm(state: StateSpec, cells: Sequence[LoadCell]) -> FloatArray:
    """Return what the cells have read in a state, as displacements, shape (c,)."""
    pairs = zip(state.reactions, cells, strict=True)
    return np.array([one.force_n * cell.mm_per_n for one, cell in pairs])


def with_load_cells(points: InterfacePoints, cells: Sequence[LoadCell]) -> InterfacePoints:
    """Return the points with one more for each cell, whose normal is the axis of the cell."""
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
    """Return the covariance of points and cells, state by state.

    Parameters
    ----------
    covariance : ndarray, shape (s k, s k)
        Of k components of points in each of s states, in mm^2.
    spec : SpecimenSpec
    cells : sequence of LoadCell
        c of them; readings err apart.

    Returns
    -------
    ndarray, shape (s (k + c), s (k + c))
    """
    states = len(spec.states)
    variances = np.array(
        [
            [(one.sd_n * cell.mm_per_n) ** 2 for one, cell in zip(s.reactions, cells, strict=True)]
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
    """An equilibrium whose solution has one more node for each cell; see `ForwardWithCells`."""

    at: Equilibrium
    solution: Solution

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.at.problem


class ForwardWithCells(Tetrahedra):
    """See `workers.diagnosis.forward.Forward`; load cells are nodes beyond those of the mesh.

    Parameters
    ----------
    cells : sequence of LoadCell
    """

    def __init__(self, cells: Sequence[LoadCell]) -> None:
        self.cells = tuple(cells)

    def equilibrium(  # type: ignore[override]
        self, model: Any, problem: Problem, start: Equilibrium | EquilibriumWithCells | None = None
    ) -> EquilibriumWithCells:
        """See `Forward.equilibrium`."""
        at = equilibrium(
            model, problem, start.at if isinstance(start, EquilibriumWithCells) else start
        )
        solution, held = at.solution, np.zeros((1, *at.solution.displacement_mm.shape))
        if solution.outcome.converged:
            held = reactions(at)[None]
        nodes = np.concatenate([solution.displacement_mm, self._read(at, held)[0]])
        return EquilibriumWithCells(at, replace(solution, displacement_mm=nodes))

    def expecting(self, at: EquilibriumWithCells, moved_mm: FloatArray) -> Equilibrium:
        """See `Forward.expecting`."""
        return at.at.expecting(moved_mm[: len(moved_mm) - len(self.cells)])

    def tangents(  # type: ignore[override]
        self, at: EquilibriumWithCells, changes: Sequence[Change], tolerance: float
    ) -> FloatArray:
        """See `Forward.tangents`."""
        moved, forces = tangents_with_reactions(at.at, changes, tolerance)
        return np.concatenate([moved, self._read(at.at, forces)], axis=1)

    def pressed(self, at: EquilibriumWithCells) -> BoolArray | None:
        """See `Forward.pressed`."""
        return super().pressed(at.at)

    def _read(self, at: Equilibrium, forces: FloatArray) -> FloatArray:
        """Return what the cells read of forces on the nodes, (b, n, 3): (b, c, 3), in mm."""
        found, level = np.zeros((len(forces), len(self.cells), 3)), at.levels[-1].model
        for number, cell in enumerate(self.cells):
            inside = nodes_in(cell.region, level.nodes, level.edge_mm)
            found[:, number, cell.axis] = cell.mm_per_n * forces[:, inside, cell.axis].sum(axis=1)
        return found
