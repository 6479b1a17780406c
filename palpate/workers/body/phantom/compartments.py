"""Compartments of adipose and glandular tissue: positions, sizes and directions.

Each compartment i is the class of a Gaussian maximum-a-posteriori classifier
with equal priors. A point belongs to the compartment with the largest discriminant

    f_i(x) = -1/2 (x - m_i)^T S_i (x - m_i) + 1/2 log det S_i

so the walls between compartments are quadrics, not planes.
"""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.body.phantom.settings import BreastPhantom

SEED_DISTANCE = 0.45  # smallest distance of two seeds, in pitches
MEAN_RADIUS = 0.9  # geometric mean of the half-axes, in pitches
THICKNESS_RANGE = (0.5, 1.0)  # relative half-axis along the normal
STRETCH_RANGE = (1.0, 2.5)  # tangential half-axes over the one along the normal
NEAR_AXIS = 1e-9


@dataclass(frozen=True, eq=False)
class Compartments:
    """Gaussian classes in space, n of them.

    Parameters
    ----------
    seeds_mm : ndarray, shape (n, 3)
        Centres m_i as (x, y, z).
    precision : ndarray, shape (n, 6)
        S_i in 1/mm^2 as xx, yy, zz, xy, xz, yz.
    offset : ndarray, shape (n,)
        1/2 log det S_i.
    """

    seeds_mm: FloatArray
    precision: FloatArray
    offset: FloatArray


def draw_compartments(settings: BreastPhantom, rng: np.random.Generator) -> Compartments:
    """Draw seeds, sizes and directions of the compartments of a breast.

    They depend only on the outline and on the number of compartments, so the
    same generator gives the same anatomy at every voxel size and density.

    Notes
    -----
    Lengths scale with the pitch ``(V / n)^(1/3)``, the edge of a cube with the
    mean volume of a compartment (11 mm for 333 in 445 ml). Half-axes follow [1]_:
    thickness along the normal of a nested ellipsoid, stretched tangentially.

    References
    ----------
    .. [1] D. D. Pokrajac et al., Med. Phys. 39(4), 2290-2302, 2012.
    """
    n = int(settings.compartments)
    pitch = float(np.cbrt(settings.outline_ml * 1000 / n))
    seeds = _draw_seeds(settings, n, SEED_DISTANCE * pitch, rng)
    thickness = rng.uniform(*THICKNESS_RANGE, n)
    stretch = rng.uniform(*STRETCH_RANGE, (n, 2))
    half_axes = thickness[:, None] * np.column_stack([np.ones(n), stretch])
    half_axes *= MEAN_RADIUS * pitch / np.cbrt(half_axes.prod(axis=1)).mean()
    frames = layer_frames(settings, seeds)
    S = np.einsum("nai,na,naj->nij", frames, half_axes**-2.0, frames)
    packed = S[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return Compartments(seeds, np.ascontiguousarray(packed), -np.log(half_axes).sum(axis=1))


def vertical_semi_axis(settings: BreastPhantom, x: FloatArray) -> FloatArray:
    """Return the semi-axis along x of the half ellipsoid on the side of `x`, in mm."""
    return np.where(x >= 0, settings.upper_mm, settings.lower_mm)


def layer_frames(settings: BreastPhantom, points_mm: FloatArray) -> FloatArray:
    """Return orthogonal directions of the tissue layers at points inside the outline.

    Nested ellipsoids keep the depth a and scale the other semi-axes by the same
    factor, so each passes through the nipple; one passes through every point.

    Returns
    -------
    ndarray, shape (n, 3, 3)
        Rows: normal of the nested ellipsoid, circumferential direction (normal
        to z), meridional direction (towards the nipple).
    """
    x, y, z = points_mm.T
    b, a = settings.half_width_mm, settings.depth_mm
    c = vertical_semi_axis(settings, x)
    free = np.maximum(1 - (z / a) ** 2, NEAR_AXIS)
    scale2 = np.maximum(((x / c) ** 2 + (y / b) ** 2) / free, NEAR_AXIS)
    normal = np.column_stack([x / (c**2 * scale2), y / (b**2 * scale2), z / a**2])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    around = np.column_stack([-normal[:, 1], normal[:, 0], np.zeros(len(normal))])
    length = np.linalg.norm(around, axis=1, keepdims=True)
    # On the axis of the nipple every direction normal to z is circumferential.
    around = np.where(length > NEAR_AXIS, around / np.maximum(length, NEAR_AXIS), [[0.0, 1.0, 0.0]])
    return np.stack([normal, around, np.cross(normal, around)], axis=1)


def _draw_seeds(
    settings: BreastPhantom, n: int, distance_mm: float, rng: np.random.Generator
) -> FloatArray:
    """Draw uniform points inside the outline, at least `distance_mm` apart.

    Balls of that size fill 5 % of the body, so a free position is found quickly.
    """
    b, a = settings.half_width_mm, settings.depth_mm
    low = np.array([-settings.lower_mm, -b, 0.0])
    high = np.array([settings.upper_mm, b, a])
    seeds = np.empty((n, 3))
    count = 0
    while count < n:
        point = rng.uniform(low, high)
        c = settings.upper_mm if point[0] >= 0 else settings.lower_mm
        if (point[0] / c) ** 2 + (point[1] / b) ** 2 + (point[2] / a) ** 2 > 1:
            continue
        if count and ((seeds[:count] - point) ** 2).sum(axis=1).min() < distance_mm**2:
            continue
        seeds[count] = point
        count += 1
    return seeds
