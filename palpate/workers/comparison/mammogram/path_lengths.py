"""Exact path lengths of rays in each tissue (Siddon's line integrals)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.comparison.mammogram.geometry import Geometry
from palpate.workers.compile_flags import EXACT, EXACT_UNCHECKED

N_TISSUES = len(Tissue)
# Pixels are processed in square tiles: their rays share cache lines.
TILE = 32


def path_lengths_mm(body: Volume, geometry: Geometry) -> NDArray[np.float32]:
    """Return the length of each ray in each tissue.

    A ray goes from the focal spot to the centre of a pixel and from voxel to voxel at its
    intersections with the planes between them [1]_; there are no steps inside a voxel, so the
    lengths are exact for these voxels.

    Parameters
    ----------
    body : Volume
        Labels of `Tissue`.
    geometry : Geometry

    Returns
    -------
    ndarray of float32, shape (rows, columns, tissues)
        In mm. For air, only the length inside the box of `body`.

    Raises
    ------
    InputError
        If a value is not a label.

    References
    ----------
    .. [1] R. L. Siddon, Fast calculation of the exact radiological path for a
       three-dimensional CT array, Med. Phys. 12 (1985) 252.
    .. [2] J. Amanatides, A. Woo, A fast voxel traversal algorithm, Eurographics 1987.
    """
    values = body.values
    if values.dtype.kind not in "biu" or int(values.max(initial=0)) >= N_TISSUES:
        raise InputError(
            f"Tissue labels must be whole numbers from 0 to {N_TISSUES - 1}, got {values.dtype} "
            f"up to {values.max(initial=0)}. Relabel the volume first."
        )
    labels = np.ascontiguousarray(values, dtype=np.uint8)
    spacing = np.asarray(body.spacing_mm, np.float64)
    corner = np.asarray(body.origin_mm, np.float64) - 0.5 * spacing
    lengths = np.zeros((geometry.rows, geometry.columns, N_TISSUES), np.float32)
    _follow(
        labels,
        corner,
        spacing,
        geometry.source_mm,
        geometry.first_mm,
        geometry.down_mm,
        geometry.right_mm,
        lengths,
    )
    return lengths


@njit(**EXACT)
def _follow(
    labels: NDArray[np.uint8],
    corner: FloatArray,
    spacing: FloatArray,
    source: FloatArray,
    first: FloatArray,
    down: FloatArray,
    right: FloatArray,
    out: NDArray[np.float32],
) -> None:
    rows, columns, _ = out.shape
    count = np.array((labels.shape[2], labels.shape[1], labels.shape[0]))
    flat = labels.reshape(-1)
    stride = np.array((1, count[0], count[0] * count[1]))
    start = (source - corner) / spacing  # in voxels
    way = np.empty(3)
    total = np.empty(N_TISSUES)
    for row0 in range(0, rows, TILE):
        for column0 in range(0, columns, TILE):
            for row in range(row0, min(row0 + TILE, rows)):
                for column in range(column0, min(column0 + TILE, columns)):
                    length = 0.0
                    for c in range(3):
                        way[c] = first[c] + row * down[c] + column * right[c] - source[c]
                        length += way[c] * way[c]
                        way[c] /= spacing[c]
                    total[:] = 0.0
                    _one_ray(flat, count, stride, start, way, total)
                    length = np.sqrt(length)
                    for t in range(N_TISSUES):
                        out[row, column, t] = total[t] * length


@njit(**EXACT_UNCHECKED)
def _one_ray(
    flat: NDArray[np.uint8],
    count: NDArray[np.int64],
    stride: NDArray[np.int64],
    start: FloatArray,
    way: FloatArray,
    total: FloatArray,
) -> None:
    """Add the part of a ray from ``start`` (0) to ``start + way`` (1) in each label."""
    enter, leave = 0.0, 1.0
    for c in range(3):
        if way[c] == 0.0:
            if start[c] < 0.0 or start[c] >= count[c]:
                return
        else:
            a, b = -start[c] / way[c], (count[c] - start[c]) / way[c]
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    if not enter < leave:
        return
    # Ray parameter at the next plane along each axis, and from plane to plane.
    cx, sx, tx, dx = _first_plane(start[0], way[0], enter, count[0])
    cy, sy, ty, dy = _first_plane(start[1], way[1], enter, count[1])
    cz, sz, tz, dz = _first_plane(start[2], way[2], enter, count[2])
    at = cx + stride[1] * cy + stride[2] * cz
    hop_x, hop_y, hop_z = sx, sy * stride[1], sz * stride[2]
    left_x = count[0] - cx if sx > 0 else cx + 1
    left_y = count[1] - cy if sy > 0 else cy + 1
    left_z = count[2] - cz if sz > 0 else cz + 1
    since = enter  # start of the current label
    label = flat[at]
    while True:
        if tx <= ty and tx <= tz:
            now = tx
            tx += dx
            at += hop_x
            left_x -= 1
            over = left_x == 0
        elif ty <= tz:
            now = ty
            ty += dy
            at += hop_y
            left_y -= 1
            over = left_y == 0
        else:
            now = tz
            tz += dz
            at += hop_z
            left_z -= 1
            over = left_z == 0
        if over or now >= leave:
            total[label] += max(leave - since, 0.0)
            return
        if flat[at] != label:
            total[label] += max(now - since, 0.0)
            label = flat[at]
            since = max(now, since)


@njit(**EXACT_UNCHECKED)
def _first_plane(
    start: float, way: float, enter: float, count: int
) -> tuple[int, int, float, float]:
    """Return the entry voxel, direction, ray parameter at its far plane, and between planes."""
    at = min(max(int(np.floor(start + enter * way)), 0), count - 1)
    if way > 0.0:
        return at, 1, (at + 1 - start) / way, 1.0 / way
    if way < 0.0:
        return at, -1, (at - start) / way, -1.0 / way
    return at, 1, np.inf, np.inf
