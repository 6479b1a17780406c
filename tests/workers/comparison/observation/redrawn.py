"""Repeated segmentations with random errors.

Every interface moves outwards by its own Gaussian random field: white noise on the voxels, blurred
by a Gaussian of standard deviation ``l / sqrt 2``, so that its correlation is ``exp(-h^2 / 2
l^2)``.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, Tissue, Volume
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    signed_distance,
)
from palpate.workers.comparison.observation.isosurface import SMOOTH_VOXELS
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise


def perturbed(
    labels: Volume, noise: SegmentationNoise, seed: int, smooth_voxels: float = SMOOTH_VOXELS
) -> Volume:
    """Move the outline and the boundary of the glandular tissue at random.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels.
    noise : SegmentationNoise
        ``sd_mm`` and ``correlation_mm`` are used; the effect of the voxels on the interfaces
        is already present.
    seed : int
        Equal seeds give equal volumes.
    smooth_voxels : float
        See `workers.comparison.observation.isosurface.surface`; thin parts are lost here too.

    Returns
    -------
    Volume
        ``uint8`` on the same grid. Tissue added to the outline, or removed from the glandular
        tissue, takes the label of the nearest voxel of another tissue, or fat if there is none. The
        end of the body at the chest wall stays in place.

    Raises
    ------
    InputError
        If the volume has no body, or the body fills it.
    """
    rng = np.random.default_rng(seed)
    body_voxels = np.flatnonzero((labels.values != Tissue.AIR).any(axis=(1, 2)))
    if not len(body_voxels):
        raise InputError("The volume contains only air. Check the labels.")
    # From the chest wall upwards; the cut at the wall is not an interface.
    wall = int(body_voxels[0])
    x, y, z = labels.origin_mm
    above = Volume(labels.values[wall:], labels.spacing_mm, (x, y, z + wall * labels.spacing_mm[2]))
    body = _moved(above, OUTLINE.inside, noise, rng, smooth_voxels)
    values = _without_gland(above.values)
    if (above.values == Tissue.GLANDULAR).any():
        gland = _moved(above, GLANDULAR.inside, noise, rng, smooth_voxels)
        values[gland] = Tissue.GLANDULAR
    values[~body] = Tissue.AIR
    whole = np.zeros(labels.values.shape, np.uint8)
    whole[wall:] = values
    return Volume(whole, labels.spacing_mm, labels.origin_mm)


def _moved(
    labels: Volume,
    inside: tuple[Tissue, ...],
    noise: SegmentationNoise,
    rng: np.random.Generator,
    smooth_voxels: float,
) -> BoolArray:
    band = 6 * noise.sd_mm + 4 * max(labels.spacing_mm)
    distance = signed_distance(labels, inside, smooth_voxels, band).values
    return np.asarray(distance < noise.sd_mm * _field(labels, noise.correlation_mm, rng))


def _field(labels: Volume, correlation_mm: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return Gaussian random numbers of variance 1 on the voxels, periodic across the box."""
    sigma = correlation_mm / np.sqrt(2) / np.asarray(labels.spacing_mm)[::-1]
    field = rng.standard_normal(labels.values.shape, np.float32)
    variance = 1.0
    for axis, width in enumerate(sigma):
        line = np.zeros(labels.values.shape[axis])
        line[0] = 1.0
        variance *= np.sum(ndimage.gaussian_filter1d(line, width, mode="wrap") ** 2)
        field = ndimage.gaussian_filter1d(field, width, axis=axis, mode="wrap")
    return np.asarray(field / np.sqrt(variance), np.float32)


def _without_gland(values: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Return the tissues as if there were no glandular tissue and no air."""
    other = ~np.isin(values, (Tissue.AIR, Tissue.GLANDULAR))
    if not other.any():
        return np.full(values.shape, Tissue.FAT, np.uint8)
    if len(np.unique(values[other])) == 1:
        return np.full(values.shape, values[other][0], np.uint8)
    nearest = ndimage.distance_transform_edt(~other, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)], np.uint8)
