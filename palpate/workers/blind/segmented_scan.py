r"""Segmented scans of a body: voxel labels with segmentation errors.

A blurred label is the normal distribution function of the distance to its boundary, so :math:`d =
\sigma \Phi^{-1}(v)` gives the distance to within less than a voxel. The boundary is moved along its
normal by a random field with two correlation lengths.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtri

from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.blind.fine_mesh import FineMesh
from palpate.workers.comparison.warp.warp_volume import warp_grey

BLUR_VOXELS = 0.8
MARGIN_MM = 6.0
# Half of the variance each; together similar to a single length of 4 mm.
LENGTHS_MM = (3.4, 4.8)
PIECE_RADIUS_MM = (3.0, 5.0)
# Fraction of a boundary's scatter left after voxels of 0.8 mm and the blur of an observer.
KEPT = 0.93


@dataclass(frozen=True, slots=True)
class Segmenter:
    """Errors of a segmentation.

    Parameters
    ----------
    sd_mm : float
        Scatter of the boundaries along their normals.
    outline_mm, glandular_mm : float
        Distances by which all labels, and the glandular ones, extend too far.
    ln_at_wall : float
        ln of the ratio of the scatter at the chest wall to the scatter at the nipple.
    pieces : int
        Number of pieces of gland missed, and also of pieces added.
    """

    sd_mm: float
    outline_mm: float = 0.0
    glandular_mm: float = 0.0
    ln_at_wall: float = 0.0
    pieces: int = 0


def glandular_share(labels: Volume) -> Volume:
    """Blur glandular labels to 0.5 at their boundary, with air assigned to the nearest tissue.

    With a margin around the labels, the elements alone determine the extent of a deformed body. If
    the voxels cut it too, it would lose about a tenth of a voxel all around.
    """
    wide = padded(labels, MARGIN_MM)
    _, (z, y, x) = ndimage.distance_transform_edt(
        wide.values == Tissue.AIR, sampling=labels.spacing_mm[::-1], return_indices=True
    )
    gland = (wide.values[z, y, x] == Tissue.GLANDULAR).astype(np.float32)
    share = ndimage.gaussian_filter(gland, BLUR_VOXELS)
    return replace(wide, values=share)


def deformed_labels(share: Volume, fine: FineMesh, displacement_mm: FloatArray) -> Volume:
    """Label the body under a displacement of its quadratic nodes, surrounded by air.

    Parameters
    ----------
    share : Volume
        Glandular share of the undeformed body, from `glandular_share`.
    fine : FineMesh
    displacement_mm : ndarray, shape (n, 3)
    """
    moved = warp_grey(share, fine.mesh, fine.interpolation @ displacement_mm, outside=-1.0)
    values = np.where(moved.values > 0.5, Tissue.GLANDULAR, Tissue.FAT).astype(np.uint8)
    values[moved.values < -0.5] = Tissue.AIR
    return padded(replace(moved, values=values), MARGIN_MM)


def padded(labels: Volume, margin_mm: float) -> Volume:
    """Add air on all sides."""
    count = int(np.ceil(margin_mm / min(labels.spacing_mm)))
    origin = np.asarray(labels.origin_mm) - count * np.asarray(labels.spacing_mm)
    x, y, z = map(float, origin)
    return replace(labels, values=np.pad(labels.values, count), origin_mm=(x, y, z))


def segmented(labels: Volume, segmenter: Segmenter, rng: np.random.Generator) -> Volume:
    """Segment the labels again, with errors.

    Parameters
    ----------
    labels : Volume
        Fat and glandular tissue surrounded by air; the body's end at the chest wall is a cut, which
        stays straight.
    segmenter : Segmenter
    rng : numpy Generator

    Returns
    -------
    Volume of uint8
        0 background, 1 fat, 2 glandular.
    """
    first = int(np.flatnonzero((labels.values != Tissue.AIR).any(axis=(1, 2)))[0])
    above = labels.values[first:]
    body = _redrawn(above != Tissue.AIR, labels.spacing_mm, segmenter, segmenter.outline_mm, rng)
    gland = _redrawn(
        above == Tissue.GLANDULAR, labels.spacing_mm, segmenter, segmenter.glandular_mm, rng
    )
    for _ in range(segmenter.pieces):
        gland &= ~_piece(gland, labels.spacing_mm, rng)
        gland |= _piece(body & ~gland, labels.spacing_mm, rng)
    drawn = np.where(gland, Tissue.GLANDULAR, Tissue.FAT) * body
    values = np.zeros(labels.values.shape, np.uint8)
    values[first:] = drawn
    return replace(labels, values=values)


def _redrawn(
    inside: NDArray[np.bool_],
    spacing_mm: tuple[float, float, float],
    segmenter: Segmenter,
    offset_mm: float,
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Return the voxels inside the boundary after moving it outwards by an offset and noise."""
    # "nearest" continues the body straight through the cut at the chest wall.
    share = ndimage.gaussian_filter(inside.astype(np.float32), BLUR_VOXELS, mode="nearest")
    depth = BLUR_VOXELS * min(spacing_mm) * ndtri(np.clip(share, 1e-6, 1 - 1e-6))
    towards_wall = np.linspace(0.5, -0.5, len(inside))[:, None, None]
    sd_mm = segmenter.sd_mm / KEPT * np.exp(segmenter.ln_at_wall * towards_wall)
    return np.asarray(depth + offset_mm + sd_mm * _waves(inside.shape, spacing_mm, rng) > 0)


def _piece(
    inside: NDArray[np.bool_], spacing_mm: tuple[float, float, float], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return the voxels of a ball somewhere inside a tissue."""
    places = np.argwhere(inside)
    z, y, x = places[rng.integers(len(places))]
    radius_mm = rng.uniform(*PIECE_RADIUS_MM)
    step = np.asarray(spacing_mm)[::-1]
    grid = np.ogrid[tuple(slice(0, n) for n in inside.shape)]
    away = sum(((g - c) * s) ** 2 for g, c, s in zip(grid, (z, y, x), step, strict=True))
    return np.asarray(away < radius_mm**2)


def _waves(
    shape: tuple[int, ...], spacing_mm: tuple[float, float, float], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Draw a random field of variance 1, shape [z, y, x]."""
    total = np.zeros(shape, np.float32)
    for length in LENGTHS_MM:
        widths = length / np.sqrt(2) / np.asarray(spacing_mm)[::-1]
        field = ndimage.gaussian_filter(rng.standard_normal(shape, np.float32), widths, mode="wrap")
        total += field / (np.sqrt(len(LENGTHS_MM)) * field.std())
    return total
