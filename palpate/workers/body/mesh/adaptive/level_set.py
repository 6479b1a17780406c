"""The surface between one tissue and the others as a smooth field.

As for the outline of the body, the fraction of the tissue in a voxel is blurred and converted to
a distance by the inverse of the normal distribution (see `workers.body.mesh.outline`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtri

from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.body.mesh.outline import SATURATION

# Standard deviation of the blur in samples: less leaves a staircase of voxels, more
# closes the gaps between neighbouring compartments.
BLUR = 0.6
MARGIN = 2


@dataclass(frozen=True, eq=False)
class LevelSet:
    """Signed distance to a surface, linear near it and constant far from it.

    Parameters
    ----------
    field : ndarray of float32, shape (nz, ny, nx)
        In mm, negative in the tissue.
    frame : ndarray, shape (2, 3)
        Position of ``field[0, 0, 0]`` and distance of the samples along x, y, z.
    volume_mm3 : float
        Volume of the tissue's voxels.
    """

    field: NDArray[np.float32]
    frame: FloatArray
    volume_mm3: float


def level_set_of(labels: Volume, tissue: Tissue, blur: float = BLUR) -> LevelSet:
    """Return the level set of the voxels of one tissue, with a sample at each voxel.

    The tissue is continued straight through the plane of the chest wall.

    Parameters
    ----------
    labels : Volume
    tissue : Tissue
    blur : float
        Standard deviation in voxels of the coarsest axis.
    """
    inside = labels.values == tissue
    spacing = np.asarray(labels.spacing_mm, np.float64)
    sigma = blur * float(spacing.max())
    part = np.pad(inside.astype(np.float32), ((0, MARGIN), (MARGIN, MARGIN), (MARGIN, MARGIN)))
    for axis, length in zip((0, 1, 2), spacing[::-1], strict=True):
        part = ndimage.gaussian_filter1d(part, sigma / length, axis=axis, mode="nearest")
    spread = _spread(blur) * float(spacing.max())
    field = np.full(part.shape, spread * -ndtri(SATURATION), np.float32)
    field[part > 0.5] *= -1
    band = (part > SATURATION) & (part < 1 - SATURATION)
    field[band] = -spread * ndtri(part[band])
    origin = np.asarray(labels.origin_mm) - np.array([MARGIN, MARGIN, 0]) * spacing
    return LevelSet(
        field,
        np.array([origin, spacing]),
        float(np.count_nonzero(inside) * labels.voxel_mm3),
    )


def _spread(blur: float) -> float:
    """Return the deviation in voxels that puts voxel centres half a voxel from a plane surface."""
    step = np.repeat((0.0, 1.0), 32)
    beside = ndimage.gaussian_filter1d(step, blur, mode="nearest")[32]
    return float(0.5 / ndtri(beside))
