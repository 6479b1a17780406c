"""The 28 similarity coefficients that thesis section 3.3.2 compares, and the GSF.

The directed distances d1 to d6 between two sets of voxels are Eqs. 3.20 to 3.25 of the thesis,
the 24 modified Hausdorff distances Eqs. 3.20 to 3.29 and Table 3.1.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.nearest_voxel import squared_distances_from_map
from palpate.workers.comparison.similarity_score import (
    Surface,
    dice,
    gsf,
    intersection_count,
    jaccard,
)
from palpate.workers.comparison.voxel_set import (
    BOUNDARY,
    INTERIOR,
    Index,
    Metric,
    VoxelSet,
    distance_map,
    voxel_set,
)

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


# D1 to D4 combine minima and are zero whenever the sets touch; the thesis omits them.
FIRST_KEPT = 5
VARIANTS = tuple(range(FIRST_KEPT, 25))
HAUSDORFF, MODIFIED_HAUSDORFF = 18, 22


def hausdorff_variants_mm(to_y: DirectedDistances, to_x: DirectedDistances) -> dict[int, float]:
    r"""Combine the directed distances in both directions, ``D[4 (i - 1) + j] = f_j(d_i)``.

    .. math:: f_1 = \min, \quad f_2 = \max, \quad f_3 = \text{mean}, \quad
              f_4 = \frac{N_X d(X, Y) + N_Y d(Y, X)}{N_X + N_Y}

    Parameters
    ----------
    to_y, to_x : DirectedDistances
        Distances from X to Y, and from Y to X.

    Returns
    -------
    dict of int to float
        D1 to D24 in mm; D18 is the Hausdorff distance, D22 the modified one.

    References
    ----------
    .. [1] M.-P. Dubuisson, A. K. Jain, A modified Hausdorff distance for object
       matching, Proc. 12th ICPR, 1994.
    """
    n_x, n_y = to_y.count, to_x.count
    variants: list[float] = []
    for x, y in zip(to_y.directed_mm, to_x.directed_mm, strict=True):
        weighted = (n_x * x + n_y * y) / (n_x + n_y)
        variants += [min(x, y), max(x, y), (x + y) / 2, weighted]
    return dict(enumerate(variants, start=1))


HAUSDORFF_NAMES = tuple(f"D{number}" for number in VARIANTS)
COEFFICIENT_NAMES = (
    "JC",
    "DC",
    "dV",
    *HAUSDORFF_NAMES,
    "SM",
    "mean_dX",
    "mean_dY",
    "std_dX",
    "std_dY",
)


@dataclass(frozen=True)
class Coefficients:
    """The 28 coefficients of a simulated set X and a real set Y (thesis section 3.3.2).

    Parameters
    ----------
    jc, dc : float
        Jaccard and Dice coefficients (Eqs. 3.17, 3.18).
    volume_difference_mm3 : float
        Volume of X minus volume of Y.
    hausdorff_mm : tuple of float
        D5 to D24 (Table 3.1), 20 numbers.
    signed_mean_mm : float
        d6(X, Y) - d6(Y, X) (Eq. 3.30).
    mean_to_y_mm, mean_to_x_mm : float
        Mean distances from the surface voxels of X to Y, and from those of Y to X.
    sd_to_y_mm, sd_to_x_mm : float
        Standard deviations of these distances.
    gsf : float
        Geometric similarity function of JC and D22, the latter in voxels (Eq. 3.31).
    """

    jc: float
    dc: float
    volume_difference_mm3: float
    hausdorff_mm: tuple[float, ...]
    signed_mean_mm: float
    mean_to_y_mm: float
    mean_to_x_mm: float
    sd_to_y_mm: float
    sd_to_x_mm: float
    gsf: float

    @property
    def by_name(self) -> dict[str, float]:
        """The 28 coefficients by their names in the thesis; see `COEFFICIENT_NAMES`."""
        surface = (self.mean_to_y_mm, self.mean_to_x_mm, self.sd_to_y_mm, self.sd_to_x_mm)
        overlap = (self.jc, self.dc, self.volume_difference_mm3)
        values = (*overlap, *self.hausdorff_mm, self.signed_mean_mm, *surface)
        return dict(zip(COEFFICIENT_NAMES, values, strict=True))

    @property
    def mhd_mm(self) -> float:
        """D22, the modified Hausdorff distance."""
        return self.by_name[f"D{MODIFIED_HAUSDORFF}"]


def coefficients(
    simulated: Volume,
    real: Volume,
    labels: Iterable[Tissue] = (Tissue.GLANDULAR,),
    surface: Surface = "boundary",
) -> Coefficients:
    """Compute all 28 coefficients for the voxels of some tissues.

    Parameters
    ----------
    simulated, real : Volume
        X and Y, labels on one lattice; their boxes may differ.
    labels : iterable of Tissue
        The voxels with any of these labels form the compared set.
    surface : {"boundary", "all"}
        "boundary": every distance is from boundary voxels to boundary voxels, as the numbers in the
        thesis imply. "all": D5 to D24 and the signed mean use distances from all voxels to the set,
        following Eqs. 3.20 to 3.25; means and standard deviations use distances from surface voxels
        to the set.

    Raises
    ------
    InputError
        If `surface` is unknown, a set is empty or the lattices differ.
    """
    if surface not in ("boundary", "all"):
        raise InputError(f"surface must be 'boundary' or 'all', got {surface!r}.")
    wanted = tuple(Tissue(label) for label in labels)
    x, y = (_filled(volume, wanted, real) for volume in (simulated, real))
    metric = Metric.of_spacing(real.spacing_mm)
    kind = BOUNDARY if surface == "boundary" else INTERIOR
    to_y = directed_distances(x, y, metric, query_kind=kind, feature_kind=kind)
    to_x = directed_distances(y, x, metric, query_kind=kind, feature_kind=kind)
    skin_to_y, skin_to_x = to_y, to_x
    if surface == "all":
        skin_to_y = directed_distances(x, y, metric, query_kind=BOUNDARY, feature_kind=INTERIOR)
        skin_to_x = directed_distances(y, x, metric, query_kind=BOUNDARY, feature_kind=INTERIOR)

    jc = jaccard(intersection_count(x, y), x.count, y.count)
    variants = hausdorff_variants_mm(to_y, to_x)
    voxel_mm = float(np.cbrt(real.voxel_mm3))
    return Coefficients(
        jc=jc,
        dc=dice(jc),
        volume_difference_mm3=(x.count - y.count) * real.voxel_mm3,
        hausdorff_mm=tuple(variants[number] for number in VARIANTS),
        signed_mean_mm=to_y.mean_mm - to_x.mean_mm,
        mean_to_y_mm=skin_to_y.mean_mm,
        mean_to_x_mm=skin_to_x.mean_mm,
        sd_to_y_mm=skin_to_y.sd_mm,
        sd_to_x_mm=skin_to_x.sd_mm,
        gsf=gsf(jc, variants[MODIFIED_HAUSDORFF] / voxel_mm),
    )


def _filled(volume: Volume, labels: tuple[Tissue, ...], lattice: Volume) -> VoxelSet:
    voxels = voxel_set(volume, labels, lattice)
    if voxels.count == 0:
        names = ", ".join(label.name.lower() for label in labels)
        raise InputError(
            f"A volume has no {names} voxel to compare; its labels are "
            f"{np.unique(volume.values)[:20].tolist()}. Check the labels of both volumes."
        )
    return voxels
