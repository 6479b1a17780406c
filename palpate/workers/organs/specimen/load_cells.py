"""Forces by which a testing machine moves regions, as additional points of a fit.

A load cell is an additional point whose displacement is its reading, scaled so that its noise
equals the noise of a point of the field. Derivatives with respect to constants and effects
therefore include the forces. Load cells are placed far from the body and from each other, so that
no spatial correlation connects them. Their readings are predicted in
`workers.organs.specimen.load_cell_forces`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from palpate.storage.values import FloatArray
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.diagnosis.problem.force_readings import FORCE
from palpate.workers.mechanics.fem.problem.regions import Region
from palpate.workers.organs.specimen.keys.loads import StateSpec
from palpate.workers.organs.specimen.problem import AXES, region_of
from palpate.workers.organs.specimen.spec import SpecimenSpec

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
            [(one.sd_n * cell.mm_per_n) ** 2 for one, cell in zip(s.reactions, cells, strict=True)]
            for s in spec.states
        ]
    )
    number = np.arange(len(covariance)).reshape(states, -1)
    read = len(covariance) + np.arange(variances.size).reshape(states, -1)
    order = np.hstack([number, read]).ravel()
    whole = block_diag(covariance, np.diag(variances.ravel()))
    return np.asarray(whole[np.ix_(order, order)])
