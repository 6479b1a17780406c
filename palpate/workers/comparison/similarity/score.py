"""Similarity scores between a candidate and the target, as defined in the thesis."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.similarity.gsf import gsf
from palpate.workers.comparison.similarity.hausdorff import ModifiedHausdorff
from palpate.workers.comparison.similarity.overlap import dice, intersection_count, jaccard
from palpate.workers.comparison.similarity.voxel_metric import Metric
from palpate.workers.comparison.similarity.voxel_set import VoxelSet, voxel_set

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
    target: Volume,
    candidate: Volume,
    labels: Iterable[Tissue],
    surface: Surface = "boundary",
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
