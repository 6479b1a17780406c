"""Forces that a testing machine needs to move a region, as further points that a fit compares.

A load cell is one more point, whose displacement is the force that it reads: the noise of its
reading counts as much as that of a point of the field. So whatever asks how constants and effects
move the points asks how they change the forces, too. Load cells lie far from the body and from
each other, so nothing that is smooth in space relates them. What a model says they read is found
in `workers.organs.specimen.load_cell_forces`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from palpate.storage.values import FloatArray
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.diagnosis.problem.force_readings import FORCE
from palpate.workers.mechanics.fem.problem.regions import Region
from palpate.workers.organs.specimen.problem import AXES, region_of
from palpate.workers.organs.specimen.spec import SpecimenSpec, StateSpec

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
