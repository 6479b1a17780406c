"""The modified Hausdorff distance to a fixed target (D22 of the thesis)."""

import numpy as np

from palpate.workers.comparison.similarity.distance_transform import DistanceMap, distance_map
from palpate.workers.comparison.similarity.nearest_voxel import (
    Distances,
    squared_distances,
    squared_distances_from_map,
)
from palpate.workers.comparison.similarity.voxel_metric import Metric
from palpate.workers.comparison.similarity.voxel_set import BOUNDARY, INTERIOR, Index, VoxelSet

# Margin on each side of a distance map, relative to the required size.
MARGIN = 0.05


class ModifiedHausdorff:
    r"""Exact modified Hausdorff distance of candidates to one target.

    .. math:: \max\Big(\frac{1}{|X|}\sum_{x \in X} d(x, Y),
                       \frac{1}{|Y|}\sum_{y \in Y} d(y, X)\Big)

    The distances in one direction are found by searching around each voxel, which is cheap for a
    good candidate, or read from an exact distance map. Both give the same whole numbers in the same
    order, and hence the same result to the last bit. The map of the target is computed when a
    candidate first needs it, then kept; it grows when a candidate extends beyond its box.

    Parameters
    ----------
    target : VoxelSet
        The target, which must not be empty.
    metric : Metric
    boundary : bool
        Whether to measure from boundary voxels to boundary voxels, rather than from all voxels to
        the set.

    References
    ----------
    .. [1] M.-P. Dubuisson, A. K. Jain, A modified Hausdorff distance for object
       matching, Proc. 12th ICPR, 1994.
    .. [2] M. A. Lago, PhD thesis, 2014, Eqs. 3.25, 3.27.
    """

    def __init__(self, target: VoxelSet, metric: Metric, *, boundary: bool = True) -> None:
        self._target = target
        self._metric = metric
        self._least_class = BOUNDARY if boundary else INTERIOR
        self._map: DistanceMap | None = None

    def distance_mm(self, candidate: VoxelSet) -> float:
        """Return the distance of a non-empty candidate, in mm."""
        return max(
            self._mean_mm(self._to_target(candidate), candidate),
            self._mean_mm(self._to_candidate(candidate), self._target),
        )

    def _mean_mm(self, squared: Distances, voxels: VoxelSet) -> float:
        count = voxels.boundary_count if self._least_class == BOUNDARY else voxels.count
        return float(np.sqrt(squared).sum()) / count * self._metric.unit_mm

    def _to_target(self, candidate: VoxelSet) -> Distances:
        if self._map is None or not self._map.covers(candidate):
            squared = squared_distances(candidate, self._target, self._least_class, self._metric)
            if squared is not None:
                return squared
            start, stop = _union_box(candidate, self._target, MARGIN)
            self._map = None  # frees the smaller map first
            self._map = distance_map(self._target, self._least_class, self._metric, start, stop)
        return squared_distances_from_map(candidate, self._least_class, self._map)

    def _to_candidate(self, candidate: VoxelSet) -> Distances:
        squared = squared_distances(self._target, candidate, self._least_class, self._metric)
        if squared is not None:
            return squared
        start, stop = _union_box(candidate, self._target, 0.0)
        distances = distance_map(candidate, self._least_class, self._metric, start, stop)
        return squared_distances_from_map(self._target, self._least_class, distances)


def _union_box(a: VoxelSet, b: VoxelSet, margin: float) -> tuple[Index, Index]:
    """Return the half-open bounding box of two sets, with a margin relative to its size."""
    start, stop = [], []
    for a0, b0, a1, b1 in zip(a.start, b.start, a.stop, b.stop, strict=True):
        low, high = min(a0, b0), max(a1, b1)
        more = int(np.ceil(margin * (high - low)))
        start.append(low - more)
        stop.append(high + more)
    return (start[0], start[1], start[2]), (stop[0], stop[1], stop[2])
