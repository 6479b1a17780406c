"""Directed distances d1 to d6 between two sets of voxels (Eqs. 3.20 to 3.25 of the thesis)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.workers.comparison.similarity.distance_transform import distance_map
from palpate.workers.comparison.similarity.nearest_voxel import squared_distances_from_map
from palpate.workers.comparison.similarity.voxel_metric import Metric
from palpate.workers.comparison.similarity.voxel_set import BOUNDARY, Index, VoxelSet

PERCENTILES = (50, 75, 90)


@dataclass(frozen=True, eq=False)
class DirectedDistances:
    """Distances from the voxels of one set to the nearest voxel of another.

    Parameters
    ----------
    squared : ndarray of int64, shape (k,)
        Nonzero squared distances in ascending order, in units of the metric.
    count : int
        Number of voxels, including those at distance zero; > 0.
    unit_mm : float
        Millimetres per unit of distance.
    """

    squared: NDArray[np.int64]
    count: int
    unit_mm: float

    def percentile_mm(self, percent: int) -> float:
        """Return the smallest distance not exceeded by at least `percent` of the voxels.

        This is the K-th ranked value of Dubuisson and Jain (1994), always one of the distances
        and never interpolated.
        """
        rank = max(1, -(-percent * self.count // 100)) - (self.count - len(self.squared))
        return math.sqrt(int(self.squared[rank - 1])) * self.unit_mm if rank > 0 else 0.0

    @property
    def mean_mm(self) -> float:
        """Arithmetic mean (Eq. 3.25)."""
        return float(np.sqrt(self.squared).sum()) / self.count * self.unit_mm

    @property
    def sd_mm(self) -> float:
        """Standard deviation over all voxels (divided by n, not n - 1)."""
        mean_square = int(self.squared.sum()) / self.count * self.unit_mm**2
        return math.sqrt(max(mean_square - self.mean_mm**2, 0.0))

    @property
    def directed_mm(self) -> tuple[float, float, float, float, float, float]:
        """d1 to d6: minimum, 50th, 75th and 90th percentiles, maximum, mean."""
        d2, d3, d4 = (self.percentile_mm(p) for p in PERCENTILES)
        return self.percentile_mm(0), d2, d3, d4, self.percentile_mm(100), self.mean_mm


def directed_distances(
    queries: VoxelSet, features: VoxelSet, metric: Metric, *, query_kind: int, feature_kind: int
) -> DirectedDistances:
    """Measure the exact distance from each voxel of one set to the nearest voxel of another.

    Parameters
    ----------
    queries, features : VoxelSet
        Non-empty sets on one lattice.
    metric : Metric
    query_kind, feature_kind : int
        ``INTERIOR`` for all voxels of a set, ``BOUNDARY`` for its boundary voxels.

    Raises
    ------
    InputError
        If the box around both is too large for 64-bit squared distances.
    """
    start, stop = _around(queries, features)
    distances = distance_map(features, feature_kind, metric, start, stop)
    squared = squared_distances_from_map(queries, query_kind, distances)
    count = queries.boundary_count if query_kind == BOUNDARY else queries.count
    return DirectedDistances(np.sort(squared), count, metric.unit_mm)


def _around(a: VoxelSet, b: VoxelSet) -> tuple[Index, Index]:
    """Return the half-open bounding box of two sets."""
    (z0, y0, x0), (z1, y1, x1) = np.minimum(a.start, b.start), np.maximum(a.stop, b.stop)
    return (int(z0), int(y0), int(x0)), (int(z1), int(y1), int(x1))
