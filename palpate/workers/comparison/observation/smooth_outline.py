"""Smoothing of a body's outline, to remove the roughness of its segmentation.

A mesh with a rough outline touches a plate at its highest bumps, and its surface is larger than the
body's; both resemble causes of a gap. Detail finer than the correlation length of the noise is
indistinguishable from noise, so it is removed.
"""

from dataclasses import replace

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.observation.gaussian_blur import blurred

LEVEL = 0.5
FARTHEST = 3.0  # reach of a Gaussian in standard deviations


def smooth_outline(labels: Volume, length_mm: float) -> Volume:
    """Smooth the outline of a body over a length, leaving the tissues inside unchanged.

    The indicator of the body is blurred by ``2 g_s - g_2s``, where g_s is a Gaussian of standard
    deviation s, which keeps curved surfaces in place; see
    `workers.comparison.observation.isosurface`. Voxels added to the body become fat. The face at
    the chest wall, the lowest slice, stays flat.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels, z from the chest wall to the nipple.
    length_mm : float
        Standard deviation s of the blur, > 0.

    Raises
    ------
    InputError
        If the length is not positive.
    """
    if not length_mm > 0:
        raise InputError(f"The smoothing length of an outline must be > 0 mm, found {length_mm:g}.")
    dx, dy, dz = labels.spacing_mm
    sigma = [length_mm / dz, length_mm / dy, length_mm / dx]
    margin = int(np.ceil(1.5 * max(sigma)))
    pad = [(0, margin), (margin, margin), (margin, margin)]
    values = np.pad(labels.values, pad)
    body = (values != Tissue.AIR).astype(np.float32)
    once = blurred(body, sigma, FARTHEST)
    twice = blurred(body, [2 * s for s in sigma], FARTHEST)
    once *= 2
    once -= twice
    inside = once > LEVEL
    values[inside & (values == Tissue.AIR)] = Tissue.FAT
    values[~inside] = Tissue.AIR
    x0, y0, z0 = labels.origin_mm
    origin = (x0 - margin * dx, y0 - margin * dy, z0)
    return replace(labels, values=values, origin_mm=origin)
