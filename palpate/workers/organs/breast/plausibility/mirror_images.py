"""Detection of mirror images: a compressed breast that fits the one at rest better when flipped.

The position of the glandular tissue is compared relative to the plates and to the bounding box of
the body. This relative position hardly depends on the amount of compression.
"""

from itertools import product

import numpy as np

from palpate.storage.values import FloatArray, Tissue, Triple
from palpate.workers.organs.breast.plausibility.extents import plate_frame
from palpate.workers.organs.breast.plausibility.scan_facts import Scan

# Cells perpendicular to the compression, along it, and from the chest wall to the nipple.
CELLS = (16, 6, 10)
# Margin by which the sum of two correlations must be better for a mirror image. In simulated pairs,
# the right orientation is better by 0.13 or more if a flip can be detected at all, and never worse
# by more than 0.01; the same holds for the pair of shared/data/breast_bct_niftysim.
MARGIN = 0.08
# Minimum sum of both correlations for two scans to count as one body.
ALIKE = 1.0

Flip = tuple[bool, bool, bool]
SAME: Flip = (False, False, False)


def mirrored(rest: Scan, scan: Scan) -> Flip:
    """Return the flips across, along and from wall to nipple under which a scan fits better.

    All are False if it fits as it is, or if the flips cannot be distinguished.
    """
    fits = likeness(rest, scan)
    best = max(fits, key=lambda flip: fits[flip])
    clear = fits[best] > fits[SAME] + MARGIN and fits[best] > ALIKE
    return best if clear else SAME


def likeness(rest: Scan, scan: Scan) -> dict[Flip, float]:
    """Return the sum of two correlations for each flip: of glandular shares and of outlines."""
    count, gland = _cells(rest, scan.axis)
    there, its_gland = _cells(scan, scan.axis)
    fits: dict[Flip, float] = {}
    for flip in product((False, True), (False, True), (False, True)):
        axes = tuple(number for number, flipped in enumerate(flip) if flipped)
        n, g = np.flip(there, axes), np.flip(its_gland, axes)
        both = np.minimum(count, n)
        outlines = _correlation(count.sum(axis=1), n.sum(axis=1), np.ones(count.shape[::2]))
        fits[flip] = _correlation(gland, g, both) + outlines
    return fits


def _cells(scan: Scan, axis: Triple) -> tuple[FloatArray, FloatArray]:
    """Return the share of the body and the glandular share of each cell."""
    points, labels, step = scan.sample
    frame = plate_frame(axis)
    u, along, z = (points @ frame.T).T
    width_u, width_along, _ = np.abs(frame) @ step
    nu, na, nz = CELLS
    column = _index(u, u.min(), np.ptp(u), width_u, nu) * nz
    column += _index(z, z.min(), np.ptp(z), step[2], nz)
    low, high = np.full(nu * nz, np.inf), np.full(nu * nz, -np.inf)
    np.minimum.at(low, column, along)
    np.maximum.at(high, column, along)
    cell = column * na
    cell += _index(along, low[column], (high - low)[column], width_along, na)
    size = nu * nz * na
    count = np.bincount(cell, minlength=size)
    gland = np.bincount(cell, labels == Tissue.GLANDULAR, minlength=size)
    shape = nu, nz, na
    n = count.reshape(shape).transpose(0, 2, 1) / len(points)
    share = (gland / np.maximum(count, 1)).reshape(shape).transpose(0, 2, 1)
    return np.asarray(n), np.asarray(share)


def _index(
    values: FloatArray, low: FloatArray | float, span: FloatArray | float, step: float, cells: int
) -> np.ndarray:
    share = (values - low + step / 2) / (span + step)
    return np.minimum((share * cells).astype(np.intp), cells - 1)


def _correlation(a: FloatArray, b: FloatArray, weight: FloatArray) -> float:
    """Return a weighted correlation; 0 if one of the two is constant."""
    if not weight.any():
        return 0.0
    u = a - np.average(a, weights=weight)
    v = b - np.average(b, weights=weight)
    size = np.sqrt((weight * u**2).sum() * (weight * v**2).sum())
    return float((weight * u * v).sum() / size) if size > 1e-12 else 0.0
