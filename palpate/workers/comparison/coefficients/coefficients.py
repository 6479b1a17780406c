"""The 28 coefficients of one comparison, and the geometric similarity function."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.coefficients.directed import directed_distances
from palpate.workers.comparison.coefficients.hausdorff_variants import (
    MODIFIED_HAUSDORFF,
    VARIANTS,
    hausdorff_variants_mm,
)
from palpate.workers.comparison.similarity.gsf import gsf
from palpate.workers.comparison.similarity.overlap import dice, intersection_count, jaccard
from palpate.workers.comparison.similarity.score import Surface
from palpate.workers.comparison.similarity.voxel_metric import Metric
from palpate.workers.comparison.similarity.voxel_set import BOUNDARY, INTERIOR, VoxelSet, voxel_set

HAUSDORFF_NAMES = tuple(f"D{number}" for number in VARIANTS)
NAMES = ("JC", "DC", "dV", *HAUSDORFF_NAMES, "SM", "mean_dX", "mean_dY", "std_dX", "std_dY")


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
        """The 28 coefficients by their names in the thesis; see `NAMES`."""
        surface = (self.mean_to_y_mm, self.mean_to_x_mm, self.sd_to_y_mm, self.sd_to_x_mm)
        overlap = (self.jc, self.dc, self.volume_difference_mm3)
        values = (*overlap, *self.hausdorff_mm, self.signed_mean_mm, *surface)
        return dict(zip(NAMES, values, strict=True))

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
