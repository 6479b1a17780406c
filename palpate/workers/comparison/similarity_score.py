"""How alike two sets of voxels are: Jaccard, Hausdorff, and the GSF of both.

The score of a candidate is the overlap of two sets of voxels (thesis Eqs. 3.17 and 3.18), the
modified Hausdorff distance to a fixed target (D22) and the geometric similarity function, GSF,
which the search minimises.
"""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.nearest_voxel import (
    Distances,
    squared_distances,
    squared_distances_from_map,
)
from palpate.workers.comparison.voxel_set import (
    BOUNDARY,
    INTERIOR,
    DistanceMap,
    Index,
    Metric,
    VoxelSet,
    distance_map,
    voxel_set,
)
from palpate.workers.kernels_and_threads import EXACT


def gsf(jc: float, mhd_voxels: float) -> float:
    r"""Return the geometric similarity function :math:`\ln((1 - JC) \cdot MHD)` (thesis, Eq. 3.31).

    Parameters
    ----------
    jc : float
        Jaccard coefficient, 0 to 1.
    mhd_voxels : float
        Modified Hausdorff distance in voxels, >= 0 or inf. Another unit would only add a constant
        to the function.

    Returns
    -------
    float
        ``-inf`` if the product is zero: for identical sets, or for a solid compared, by boundary
        distances, with its own layer of boundary voxels.

    Examples
    --------
    >>> gsf(0.5, 2.0)
    0.0
    >>> gsf(1.0, 0.0)
    -inf
    """
    product = 0.0 if mhd_voxels == 0.0 else (1.0 - jc) * mhd_voxels
    return math.log(product) if product > 0.0 else -math.inf


def intersection_count(x: VoxelSet, y: VoxelSet) -> int:
    """Count the voxels in both sets."""
    start = [max(a, b) for a, b in zip(x.start, y.start, strict=True)]
    stop = [min(a, b) for a, b in zip(x.stop, y.stop, strict=True)]
    if any(a >= b for a, b in zip(start, stop, strict=True)):
        return 0
    views = [
        s.mask[tuple(slice(a - o, b - o) for a, b, o in zip(start, stop, s.start, strict=True))]
        for s in (x, y)
    ]
    return int(_count_both(*views))


def jaccard(intersection: int, count_x: int, count_y: int) -> float:
    r"""Return the Jaccard coefficient :math:`|X \cap Y| / |X \cup Y|`; 1 for two empty sets."""
    union = count_x + count_y - intersection
    return intersection / union if union else 1.0


def dice(jc: float) -> float:
    """Return the Dice coefficient ``2 JC / (JC + 1)``."""
    return 2.0 * jc / (jc + 1.0)


@njit(**EXACT)
def _count_both(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> int:
    total = 0
    for z in range(a.shape[0]):
        for y in range(a.shape[1]):
            p, q = a[z, y], b[z, y]
            line = 0
            for x in range(a.shape[2]):
                line += (p[x] != 0) & (q[x] != 0)
            total += line
    return total


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


Surface = Literal["boundary", "all"]


@dataclass(frozen=True)
class Score:
    """Similarity of two sets of voxels.

    Parameters
    ----------
    jc, dice : float
        Jaccard and Dice coefficients, 1 for identical sets.
    mhd_mm : float
        Modified Hausdorff distance; inf for an empty candidate.
    mhd_voxels : float
        `mhd_mm` divided by the geometric mean of the three spacings; for cubic voxels, the distance
        in voxels.
    gsf : float
        ``ln((1 - jc) mhd_voxels)``: -inf for identical sets, +inf for an empty
        candidate.
    """

    jc: float
    dice: float
    mhd_mm: float
    mhd_voxels: float
    gsf: float

    def as_dict(self) -> dict[str, float]:
        """Return the five numbers by name."""
        return asdict(self)


class Scorer:
    """Scoring of candidates against one target.

    Data are cached between candidates, so a scorer must not be shared between threads.

    Parameters
    ----------
    target : Volume
        Labels of the target.
    labels : iterable of Tissue
        The voxels with any of these labels form the compared set.
    surface : {"boundary", "all"}
        Voxels between which the modified Hausdorff distance is measured. "boundary", from boundary
        voxels (those with a face neighbour outside the set) to boundary voxels, is implied by the
        numbers in the thesis; "all", from every voxel to the set, follows its Eq. 3.25.

    Raises
    ------
    InputError
        If the target has none of the labels, or `surface` is unknown.
    """

    def __init__(
        self,
        target: Volume,
        labels: Iterable[Tissue] = (Tissue.GLANDULAR,),
        surface: Surface = "boundary",
    ) -> None:
        if surface not in ("boundary", "all"):
            raise InputError(f"surface must be 'boundary' or 'all', got {surface!r}.")
        self._labels = tuple(Tissue(label) for label in labels)
        if not self._labels or Tissue.AIR in self._labels:
            raise InputError(
                "Name one or more tissues to compare, but not AIR, which is unbounded; got "
                f"{[label.name.lower() for label in self._labels]}."
            )
        self._lattice = target
        self._target = voxel_set(target, self._labels, target)
        if self._target.count == 0:
            names = ", ".join(label.name.lower() for label in self._labels)
            raise InputError(
                f"The target has no {names} voxel to compare with; its labels are "
                f"{np.unique(target.values)[:20].tolist()}. Check the labels of the target and "
                "of the score."
            )
        self._mhd = ModifiedHausdorff(
            self._target, Metric.of_spacing(target.spacing_mm), boundary=surface == "boundary"
        )

    def score(self, candidate: Volume) -> Score:
        """Compare a candidate with the target.

        Parameters
        ----------
        candidate : Volume
            Labels on the lattice of the target; the box may differ. Outside a box there is air.

        Returns
        -------
        Score

        Raises
        ------
        InputError
            If the voxels are not on the lattice of the target.
        """
        voxels = voxel_set(candidate, self._labels, self._lattice)
        if voxels.count == 0:
            return Score(jc=0.0, dice=0.0, mhd_mm=np.inf, mhd_voxels=np.inf, gsf=np.inf)
        return self._compare(voxels)

    def _compare(self, voxels: VoxelSet) -> Score:
        jc = jaccard(intersection_count(voxels, self._target), voxels.count, self._target.count)
        mhd_mm = 0.0 if jc == 1.0 else self._mhd.distance_mm(voxels)
        mhd_voxels = mhd_mm / float(self._lattice.voxel_mm3 ** (1.0 / 3.0))
        return Score(jc, dice(jc), mhd_mm, mhd_voxels, gsf(jc, mhd_voxels))


def score_labels(
    target: Volume, candidate: Volume, labels: Iterable[Tissue], surface: Surface = "boundary"
) -> dict[Tissue, Score]:
    """Score each tissue separately.

    Parameters
    ----------
    target, candidate : Volume
        Labels on one lattice.
    labels : iterable of Tissue
        The tissues; each must occur in the target.
    surface : {"boundary", "all"}
        See `Scorer`.

    Returns
    -------
    dict of Tissue to Score

    Raises
    ------
    InputError
        See `Scorer` and `Scorer.score`.
    """
    return {label: Scorer(target, (label,), surface).score(candidate) for label in labels}
