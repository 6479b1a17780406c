"""A section through a cornea: two surfaces as polylines."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray


@dataclass(frozen=True, eq=False)
class Section:
    """The two surfaces of a corneal section, from the left to the right limbus.

    The x axis points along the chord from limbus to limbus, the y axis out of the eye, so the
    anterior surface has the larger y. Both surfaces start at the left edge of the section and
    end at the right edge.

    Parameters
    ----------
    anterior_mm, posterior_mm : ndarray, shape (k, 2) and (m, 2)
        Points of the outer and the inner surface, x ascending along the undeformed ones.

    Raises
    ------
    InputError
        If a surface has fewer than three points or a coordinate is not finite.
    """

    anterior_mm: FloatArray
    posterior_mm: FloatArray

    def __post_init__(self) -> None:
        for name, surface in (("anterior", self.anterior_mm), ("posterior", self.posterior_mm)):
            if surface.ndim != 2 or surface.shape[1] != 2 or len(surface) < 3:
                raise InputError(
                    f"The {name} surface of a cornea needs at least three points (x, y) in mm, "
                    f"found an array of shape {surface.shape}."
                )
            if not np.isfinite(surface).all():
                raise InputError(
                    f"The {name} surface of the cornea has coordinates that are not "
                    "finite. Check the segmentation of the image."
                )

    @property
    def outline_mm(self) -> FloatArray:
        """Return the closed polygon: anterior surface left to right, posterior surface back."""
        return np.concatenate([self.anterior_mm, self.posterior_mm[::-1]])
