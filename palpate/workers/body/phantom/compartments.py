"""Compartments of a breast phantom, and the tissue of a point: air, skin, ligament or compartment.

Each compartment i is the class of a Gaussian maximum-a-posteriori classifier with equal priors.
A point belongs to the compartment with the largest discriminant

    f_i(x) = -1/2 (x - m_i)^T S_i (x - m_i) + 1/2 log det S_i

so the walls between compartments are quadrics, not planes. `compartment_at` defines the phantom;
`workers.body.phantom.octree` only avoids most of its evaluations.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import FloatArray
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.kernels_and_threads import EXACT

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


Ids = NDArray[np.uint16]
Candidates = NDArray[np.int16]

AIR_ID: Final = 0
SKIN_ID: Final = 1
LIGAMENT_ID: Final = 2
FIRST_ID: Final = 3  # compartment i has the id FIRST_ID + i

# Entries of the `shape` vector: semi-axes and layer thicknesses in mm.
LOWER, UPPER, HALF_WIDTH, DEPTH, SKIN, HALF_LIGAMENT = range(6)


@njit(inline="always", **EXACT)
def ray_length(F: float, g: float, kappa: float) -> float:
    """Return the smallest root s >= 0 of ``F - g s + kappa s^2 / 2``; infinity if there is none.

    This is the distance, along its gradient, to the surface where a quadratic function
    vanishes: value F >= 0, gradient length g >= 0 and curvature kappa along it.
    """
    square = g * g - 2.0 * F * kappa
    if square < 0.0:
        return math.inf
    denominator = g + math.sqrt(square)
    if denominator == 0.0:
        return 0.0 if F == 0.0 else math.inf
    return 2.0 * F / denominator


@njit(inline="always", **EXACT)
def skin_depth(q: float, gx: float, gy: float, gz: float, c: float, b: float, a: float) -> float:
    """Return the distance to the outline along the outward gradient, in mm.

    `q` = (x/c)^2 + (y/b)^2 + (z/a)^2 <= 1 and (gx, gy, gz) its gradient. The outline
    is where 1 - q vanishes, so the curvature has a minus sign.
    """
    g2 = gx * gx + gy * gy + gz * gz
    if g2 == 0.0:
        return math.inf
    bend = 2.0 * ((gx / c) ** 2 + (gy / b) ** 2 + (gz / a) ** 2) / g2
    return ray_length(1.0 - q, math.sqrt(g2), -bend)


@njit(**EXACT)
def compartment_at(
    x: float,
    y: float,
    z: float,
    candidates: Candidates,
    n: int,
    seeds: FloatArray,
    S: FloatArray,
    offset: FloatArray,
    half: float,
) -> int:
    """Return the id of the winning compartment, or of ligament if a wall is closer than `half`.

    The wall to another compartment j is where f_best - f_j vanishes; as the
    difference is quadratic, `ray_length` along its gradient is exact.
    """
    best = -math.inf
    i = 0
    for t in range(n):
        j = candidates[t]
        dx, dy, dz = x - seeds[j, 0], y - seeds[j, 1], z - seeds[j, 2]
        form = S[j, 0] * dx * dx + S[j, 1] * dy * dy + S[j, 2] * dz * dz
        form += 2.0 * (S[j, 3] * dx * dy + S[j, 4] * dx * dz + S[j, 5] * dy * dz)
        f = offset[j] - 0.5 * form
        if f > best:
            best = f
            i = j
    if half <= 0.0 or n == 1:
        return FIRST_ID + i
    dx, dy, dz = x - seeds[i, 0], y - seeds[i, 1], z - seeds[i, 2]
    ix = S[i, 0] * dx + S[i, 3] * dy + S[i, 4] * dz
    iy = S[i, 3] * dx + S[i, 1] * dy + S[i, 5] * dz
    iz = S[i, 4] * dx + S[i, 5] * dy + S[i, 2] * dz
    for t in range(n):
        j = candidates[t]
        if j == i:
            continue
        dx, dy, dz = x - seeds[j, 0], y - seeds[j, 1], z - seeds[j, 2]
        jx = S[j, 0] * dx + S[j, 3] * dy + S[j, 4] * dz
        jy = S[j, 3] * dx + S[j, 1] * dy + S[j, 5] * dz
        jz = S[j, 4] * dx + S[j, 5] * dy + S[j, 2] * dz
        F = best - (offset[j] - 0.5 * (jx * dx + jy * dy + jz * dz))
        ex, ey, ez = ix - jx, iy - jy, iz - jz
        g2 = ex * ex + ey * ey + ez * ez
        bend = (S[j, 0] - S[i, 0]) * ex * ex + (S[j, 1] - S[i, 1]) * ey * ey
        bend += (S[j, 2] - S[i, 2]) * ez * ez + 2.0 * (S[j, 3] - S[i, 3]) * ex * ey
        bend += 2.0 * ((S[j, 4] - S[i, 4]) * ex * ez + (S[j, 5] - S[i, 5]) * ey * ez)
        kappa = bend / g2 if g2 > 0.0 else 0.0
        if ray_length(max(F, 0.0), math.sqrt(g2), kappa) < half:
            return LIGAMENT_ID
    return FIRST_ID + i


@njit(**EXACT)
def fill_voxels(
    ids: Ids,
    box: NDArray[np.int32],
    origin: FloatArray,
    spacing: float,
    shape: FloatArray,
    candidates: Candidates,
    n: int,
    seeds: FloatArray,
    S: FloatArray,
    offset: FloatArray,
) -> None:
    """Evaluate every voxel of a box, given the `n` candidates that may matter there.

    With all compartments as candidates this is the brute-force evaluation.

    Parameters
    ----------
    ids : ndarray of uint16, shape (nz, ny, nx)
        Written inside the box; air is left unchanged (0).
    box : ndarray of int32, shape (6,)
        First and last-plus-one voxel along x, y and z: x0, x1, y0, y1, z0, z1.
    origin : ndarray, shape (3,)
        Centre of the voxel ``ids[0, 0, 0]`` in mm.
    """
    b, a, half = shape[HALF_WIDTH], shape[DEPTH], shape[HALF_LIGAMENT]
    for k in range(box[4], box[5]):
        z = origin[2] + k * spacing
        for j in range(box[2], box[3]):
            y = origin[1] + j * spacing
            for i in range(box[0], box[1]):
                x = origin[0] + i * spacing
                c = shape[UPPER] if x >= 0.0 else shape[LOWER]
                q = (x / c) ** 2 + (y / b) ** 2 + (z / a) ** 2
                if q > 1.0:
                    continue
                gx, gy, gz = 2.0 * x / c**2, 2.0 * y / b**2, 2.0 * z / a**2
                if skin_depth(q, gx, gy, gz, c, b, a) < shape[SKIN]:
                    ids[k, j, i] = SKIN_ID
                else:
                    ids[k, j, i] = compartment_at(x, y, z, candidates, n, seeds, S, offset, half)
