"""Voxels of a breast by recursive partitioning.

A box of voxels is skipped if it is in air, filled at once if it is in
the skin or in one compartment, and split otherwise. Small boxes are evaluated
voxel by voxel with the few compartments that are left. Every bound is rigorous:
the result equals an evaluation of each voxel with all compartments.

References
----------
.. [1] D. D. Pokrajac, A. D. A. Maidment, P. R. Bakic, Med. Phys. 39(4), 2290-2302, 2012.
"""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import FloatArray
from palpate.workers.body.phantom.compartments import (
    DEPTH,
    FIRST_ID,
    HALF_LIGAMENT,
    HALF_WIDTH,
    LOWER,
    SKIN,
    SKIN_ID,
    UPPER,
    Candidates,
    Compartments,
    Ids,
    fill_voxels,
    ray_length,
)
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.kernels_and_threads import EXACT

Box = NDArray[np.int32]

LEAF_VOXELS: Final = 4  # longest side of a box that is evaluated voxel by voxel
MAX_LEVELS: Final = 24  # halvings of the longest side; 4 * 2^24 voxels
SLACK: Final = 1e-9  # far above rounding of the bounds, far below a voxel

IN_AIR, IN_SKIN, INSIDE, MIXED = range(4)


def partition(settings: BreastPhantom, compartments: Compartments) -> tuple[Ids, int]:
    """Compute the ids of all voxels, by octree.

    Returns
    -------
    ids : ndarray of uint16, shape (nz, ny, nx)
        0 air, 1 skin, 2 ligament, ``FIRST_ID + i`` compartment i.
    boxes : int
        Number of boxes visited.
    """
    nx, ny, nz = settings.shape_xyz
    ids = np.zeros((nz, ny, nx), dtype=np.uint16)
    # No box crosses x = 0, where the two half ellipsoids meet.
    below = settings.voxels_below
    roots = np.array([[0, below, 0, ny, 0, nz], [below, nx, 0, ny, 0, nz]], dtype=np.int32)
    boxes = _traverse(
        ids,
        roots,
        np.asarray(settings.origin_mm),
        float(settings.spacing_mm),
        shape_vector(settings),
        compartments.seeds_mm,
        compartments.precision,
        compartments.offset,
    )
    return ids, int(boxes)


def shape_vector(settings: BreastPhantom) -> FloatArray:
    """Return lengths of the outline and its layers in mm, as used by the kernels."""
    shape = np.empty(6)
    shape[LOWER] = settings.lower_mm
    shape[UPPER] = settings.upper_mm
    shape[HALF_WIDTH] = settings.half_width_mm
    shape[DEPTH] = settings.depth_mm
    shape[SKIN] = settings.skin_mm
    shape[HALF_LIGAMENT] = settings.ligament_mm / 2
    return shape


@njit(inline="always", **EXACT)
def _near_far(low: float, high: float) -> tuple[float, float]:
    """Return the smallest and largest absolute value in an interval."""
    near = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
    return near, max(abs(low), abs(high))


@njit(**EXACT)
def _place(box: Box, origin: FloatArray, spacing: float, shape: FloatArray) -> int:
    """Return the region of all voxel centres of a box on one side of x = 0, or MIXED.

    The depth below the skin grows with the value 1 - q and falls with the
    gradient and the curvature of q, so their bounds on the box bound the depth.
    """
    x0, x1 = origin[0] + box[0] * spacing, origin[0] + (box[1] - 1) * spacing
    y0, y1 = origin[1] + box[2] * spacing, origin[1] + (box[3] - 1) * spacing
    z0, z1 = origin[2] + box[4] * spacing, origin[2] + (box[5] - 1) * spacing
    c = shape[UPPER] if x0 >= 0.0 else shape[LOWER]
    b, a, skin = shape[HALF_WIDTH], shape[DEPTH], shape[SKIN]
    xn, xf = _near_far(x0, x1)
    yn, yf = _near_far(y0, y1)
    zn, zf = _near_far(z0, z1)
    q_min = (xn / c) ** 2 + (yn / b) ** 2 + (zn / a) ** 2
    if q_min > 1.0 + SLACK:
        return IN_AIR
    q_max = (xf / c) ** 2 + (yf / b) ** 2 + (zf / a) ** 2
    if q_max > 1.0 - SLACK:
        return MIXED
    steepest = 2.0 * math.sqrt((xf / c**2) ** 2 + (yf / b**2) ** 2 + (zf / a**2) ** 2)
    flattest = 2.0 * math.sqrt((xn / c**2) ** 2 + (yn / b**2) ** 2 + (zn / a**2) ** 2)
    if ray_length(1.0 - q_max, steepest, -2.0 / min(a, b, c) ** 2) >= skin + SLACK:
        return INSIDE
    if ray_length(1.0 - q_min, flattest, -2.0 / max(a, b, c) ** 2) < skin - SLACK:
        return IN_SKIN
    return MIXED


@njit(**EXACT)
def _prune(
    box: Box,
    origin: FloatArray,
    spacing: float,
    half: float,
    candidates: Candidates,
    n: int,
    kept: Candidates,
    seeds: FloatArray,
    S: FloatArray,
    offset: FloatArray,
    work: FloatArray,
) -> int:
    """Keep candidates that may win a voxel of the box, or have a wall within `half` of one.

    With b the winner at the centre, ``f_j - f_b`` is quadratic: value, gradient
    and Hessian S_b - S_j at the centre bound it by `u` on the box, and its
    gradient by `G` and curvature by `K`. Only candidates with u >= 0 can win.
    A wall to j closer than `half` to a point won by i needs

        f_i - f_j <= half |grad (f_i - f_j)| + half^2 / 2 |S_i - S_j|

    whose left side is at least -u_j and whose right side is at most
    ``half (G_i + G_j) + half^2 / 2 (K_i + K_j)``.
    """
    hx = 0.5 * (box[1] - box[0] - 1) * spacing
    hy = 0.5 * (box[3] - box[2] - 1) * spacing
    hz = 0.5 * (box[5] - box[4] - 1) * spacing
    x = origin[0] + box[0] * spacing + hx
    y = origin[1] + box[2] * spacing + hy
    z = origin[2] + box[4] * spacing + hz
    b = -1
    best = -math.inf
    for t in range(n):
        j = candidates[t]
        dx, dy, dz = x - seeds[j, 0], y - seeds[j, 1], z - seeds[j, 2]
        gx = S[j, 0] * dx + S[j, 3] * dy + S[j, 4] * dz
        gy = S[j, 3] * dx + S[j, 1] * dy + S[j, 5] * dz
        gz = S[j, 4] * dx + S[j, 5] * dy + S[j, 2] * dz
        f = offset[j] - 0.5 * (gx * dx + gy * dy + gz * dz)
        work[t, 0], work[t, 1], work[t, 2], work[t, 3] = f, gx, gy, gz
        if f > best:
            best = f
            b = t
    i = candidates[b]
    bx, by, bz = work[b, 1], work[b, 2], work[b, 3]
    steepest = 0.0
    bent = 0.0
    for t in range(n):
        j = candidates[t]
        xx, yy, zz = S[i, 0] - S[j, 0], S[i, 1] - S[j, 1], S[i, 2] - S[j, 2]
        xy, xz, yz = abs(S[i, 3] - S[j, 3]), abs(S[i, 4] - S[j, 4]), abs(S[i, 5] - S[j, 5])
        gx, gy, gz = abs(bx - work[t, 1]), abs(by - work[t, 2]), abs(bz - work[t, 3])
        u = work[t, 0] - best + hx * gx + hy * gy + hz * gz
        u += 0.5 * (hx * hx * max(xx, 0.0) + hy * hy * max(yy, 0.0) + hz * hz * max(zz, 0.0))
        u += hx * hy * xy + hx * hz * xz + hy * hz * yz
        gx += abs(xx) * hx + xy * hy + xz * hz
        gy += xy * hx + abs(yy) * hy + yz * hz
        gz += xz * hx + yz * hy + abs(zz) * hz
        G = math.sqrt(gx * gx + gy * gy + gz * gz)
        K = math.sqrt(xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz))
        if u >= -SLACK:
            steepest = max(steepest, G)
            bent = max(bent, K)
        work[t, 0], work[t, 1], work[t, 2] = u, G, K
    count = 0
    for t in range(n):
        reach = half * (work[t, 1] + steepest) + 0.5 * half * half * (work[t, 2] + bent)
        if work[t, 0] + reach >= -SLACK:
            kept[count] = candidates[t]
            count += 1
    return count


@njit(**EXACT)
def _fill(ids: Ids, box: Box, value: int) -> None:
    for k in range(box[4], box[5]):
        for j in range(box[2], box[3]):
            for i in range(box[0], box[1]):
                ids[k, j, i] = value


@njit(**EXACT)
def _push_parts(box: Box, level: int, stack: Box, top: int) -> int:
    """Push the parts of a box, halved along its longer sides, on the stack."""
    longest = max(box[1] - box[0], box[3] - box[2], box[5] - box[4])
    edges = np.empty((3, 3), dtype=np.int32)
    parts = np.empty(3, dtype=np.int32)
    for axis in range(3):
        low, high = box[2 * axis], box[2 * axis + 1]
        # A side is kept whole if it is at most half the longest: boxes become cubes.
        parts[axis] = 2 if 2 * (high - low) > longest else 1
        edges[axis, 0] = low
        edges[axis, 1] = low + (high - low) // 2 if parts[axis] == 2 else high
        edges[axis, 2] = high
    for k in range(parts[2]):
        for j in range(parts[1]):
            for i in range(parts[0]):
                stack[top, 0], stack[top, 1] = edges[0, i], edges[0, i + 1]
                stack[top, 2], stack[top, 3] = edges[1, j], edges[1, j + 1]
                stack[top, 4], stack[top, 5] = edges[2, k], edges[2, k + 1]
                stack[top, 6] = level
                top += 1
    return top


@njit(**EXACT)
def _traverse(
    ids: Ids,
    roots: Box,
    origin: FloatArray,
    spacing: float,
    shape: FloatArray,
    seeds: FloatArray,
    S: FloatArray,
    offset: FloatArray,
) -> int:
    """Visit all boxes, depth first; return their number.

    A box of one level reads the candidates of that level and writes its own to the next, which
    are read only by its parts and theirs before the box is done.
    """
    n = offset.shape[0]
    lists = np.empty((MAX_LEVELS + 1, n), dtype=np.int16)
    counts = np.empty(MAX_LEVELS + 1, dtype=np.int64)
    stack = np.empty((8 * MAX_LEVELS, 7), dtype=np.int32)
    work = np.empty((n, 4))
    box = np.empty(6, dtype=np.int32)
    for t in range(n):
        lists[0, t] = t
    counts[0] = n
    boxes = 0
    for root in range(roots.shape[0]):
        stack[0, :6] = roots[root]
        stack[0, 6] = 0
        top = 1
        while top > 0:
            top -= 1
            boxes += 1
            level = stack[top, 6]
            for axis in range(6):
                box[axis] = stack[top, axis]
            place = _place(box, origin, spacing, shape)
            if place == IN_AIR:
                continue
            if place == IN_SKIN:
                _fill(ids, box, SKIN_ID)
                continue
            kept = lists[level + 1]
            count = _prune(
                box,
                origin,
                spacing,
                shape[HALF_LIGAMENT],
                lists[level],
                counts[level],
                kept,
                seeds,
                S,
                offset,
                work,
            )
            counts[level + 1] = count
            if count == 1 and place == INSIDE:
                _fill(ids, box, FIRST_ID + kept[0])
            elif max(box[1] - box[0], box[3] - box[2], box[5] - box[4]) <= LEAF_VOXELS:
                fill_voxels(ids, box, origin, spacing, shape, kept, count, seeds, S, offset)
            else:
                top = _push_parts(box, level + 1, stack, top)
    return boxes
