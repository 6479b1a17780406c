"""Similarity of two corneal sections."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.comparison.similarity.gsf import gsf
from palpate.workers.organs.cornea.section.contour_distance import contour_samples, mean_distance
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.section.polygon_areas import overlap_areas

# Spacing of samples along the contours, in pixels; a mean distance of 5 pixels changes by less
# than 0.001 pixels from here to a tenth of this spacing.
SPACING_PIXELS = 5.0


@dataclass(frozen=True)
class SectionScore:
    """Similarity of two sections.

    Parameters
    ----------
    jc : float
        Jaccard coefficient of the areas, 0 to 1.
    mhd_um : float
        Modified Hausdorff distance from contour to contour.
    gsf : float
        Geometric similarity function ln((1 - JC) MHD) with MHD in pixels; -inf for
        identical sections.
    """

    jc: float
    mhd_um: float
    gsf: float


class SectionTarget:
    r"""A section for comparison with candidates, without rasterisation.

    Areas are exact (`overlap_areas`). The modified Hausdorff distance (D22 of the thesis,
    Eq. 3.25 and 3.26) is between boundaries, as the thesis' tables prove,

    .. math:: \max\Big(\frac{1}{|\partial X|}\int_{\partial X} d(x, \partial Y),
                       \frac{1}{|\partial Y|}\int_{\partial Y} d(y, \partial X)\Big)

    with exact distances to the sides of the other contour. By default a piece of a contour is
    weighted by its number of boundary pixels (the larger of its extents along x and y), so the
    result equals that of images without rounding; ``pixelwise=False`` weights it by its length.

    Parameters
    ----------
    section : Section
    pixel_um : float
        Pixels of the thesis' images, 2 um; > 0. Sets only the unit of the distance in the
        GSF and the spacing of the samples.
    pixelwise : bool

    Raises
    ------
    InputError
        If `pixel_um` is not positive or the section has no area.
    """

    def __init__(self, section: Section, pixel_um: float = 2.0, pixelwise: bool = True) -> None:
        if not (np.isfinite(pixel_um) and pixel_um > 0):
            raise InputError(f"A pixel must have a positive size, got {pixel_um} um.")
        self._outline = np.ascontiguousarray(section.outline_mm)
        if overlap_areas(self._outline, self._outline)[0] <= 0:
            raise InputError("The target section has no area. Check its contours.")
        self._pixel_um = pixel_um
        self._pixelwise = pixelwise
        self._samples = contour_samples(self._outline, self._spacing_mm, pixelwise)

    @property
    def _spacing_mm(self) -> float:
        return SPACING_PIXELS * self._pixel_um / 1000

    def score(self, candidate: Section) -> SectionScore:
        """Return the similarity of a candidate.

        Parameters
        ----------
        candidate : Section

        Returns
        -------
        SectionScore
        """
        outline: FloatArray = np.ascontiguousarray(candidate.outline_mm)
        area, target_area, shared = overlap_areas(outline, self._outline)
        union = area + target_area - shared
        # Rounding may leave a difference in the last digit between areas of identical sections.
        jc = float(np.clip(shared / union, 0.0, 1.0))
        samples = contour_samples(outline, self._spacing_mm, self._pixelwise)
        mhd_mm = max(mean_distance(samples, self._outline), mean_distance(self._samples, outline))
        mhd_um = 1000 * mhd_mm
        return SectionScore(jc=jc, mhd_um=mhd_um, gsf=gsf(jc, mhd_um / self._pixel_um))
