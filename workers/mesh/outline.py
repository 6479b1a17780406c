"""The outline of a body as a smooth field, from its voxels.

Occupancy (labels other than air) is averaged over blocks of voxels, blurred with
a Gaussian of standard deviation ``s`` and turned into a distance: beside a flat
surface the blurred occupancy is ``Phi(-d / s)`` with ``d`` the signed distance
and ``Phi`` the normal distribution, so ``d = -s Phi^-1(u)``. The field is linear
across the surface, smooth below the size of a voxel, negative inside, and
saturates about 2.5 s away, where only its sign matters.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtri

from storage.errors import InputError
from storage.values import FloatArray, Triple, Volume

BLUR = 0.9  # blur in grid steps; less shows the voxels' staircase, more rounds the rim
SATURATION = 0.006  # occupancy beyond which the distance is cut off (2.5 standard deviations)


@dataclass(frozen=True, eq=False)
class Outline:
    """Signed distance to the skin of a body that ends at the plane of the chest wall.

    Parameters
    ----------
    field : ndarray of float32, shape (nz, ny, nx)
        Signed distance in mm, negative inside; continued straight below the wall.
    origin_mm, step_mm : tuple of float
        Place (x, y, z) of ``field[0, 0, 0]`` and distance of the samples.
    wall_z_mm : float
        Lower face of the body's lowest voxels.
    volume_mm3 : float
        Volume of the body's voxels, enclosed cavities included.
    lower_mm, upper_mm : ndarray, shape (3,)
        Bounding box of the body.
    """

    field: NDArray[np.float32]
    origin_mm: Triple
    step_mm: Triple
    wall_z_mm: float
    volume_mm3: float
    lower_mm: FloatArray
    upper_mm: FloatArray

    @property
    def smallest_extent_mm(self) -> float:
        """Shortest side of the bounding box."""
        return float(np.min(self.upper_mm - self.lower_mm))

    @property
    def frame(self) -> FloatArray:
        """Origin and step in one array of shape (2, 3), as the kernels take them."""
        return np.array([self.origin_mm, self.step_mm])


def outline_of(labels: Volume, step_mm: float) -> Outline:
    """Outline of the largest connected body in a label volume.

    Parameters
    ----------
    labels : Volume
        Tissue labels; 0 is air.
    step_mm : float
        Wanted distance of the samples; at least one voxel.

    Raises
    ------
    InputError
        If every voxel is air.
    """
    spacing = np.asarray(labels.spacing_mm)
    block = np.maximum(1, np.rint(step_mm / spacing)).astype(np.int64)
    box = _body_box(labels.values)
    lo, hi = box[:, 0].copy(), box[:, 1].copy()
    occupancy = _block_mean(labels.values, lo, hi, block)
    occupancy = _one_solid_body(occupancy)

    step = spacing * block
    filled = np.argwhere(occupancy.max(axis=(1, 2)) > 0).ravel()
    occupancy = occupancy[filled[0] :]
    lo[2] += filled[0] * block[2]
    wall_z = labels.origin_mm[2] + (lo[2] - 0.5) * spacing[2]

    pad = 6
    padded = np.pad(occupancy, ((0, pad), (pad, pad), (pad, pad)))
    first = np.asarray(labels.origin_mm) + (lo - 0.5) * spacing + 0.5 * step
    origin = first - np.array([pad, pad, 0]) * step
    field, blurred_volume = _distance(padded, step)
    del blurred_volume
    inside = np.argwhere(occupancy > 0)
    lower = first + (inside.min(axis=0)[::-1] - 0.5) * step
    upper = first + (inside.max(axis=0)[::-1] + 0.5) * step
    body_lo = np.asarray(labels.origin_mm) + (box[:, 0] - 0.5) * spacing
    body_hi = np.asarray(labels.origin_mm) + (box[:, 1] - 0.5) * spacing
    return Outline(
        field=field,
        origin_mm=(float(origin[0]), float(origin[1]), float(origin[2])),
        step_mm=(float(step[0]), float(step[1]), float(step[2])),
        wall_z_mm=float(wall_z),
        volume_mm3=float(occupancy.sum(dtype=np.float64) * np.prod(step)),
        lower_mm=np.maximum(lower, body_lo),
        upper_mm=np.minimum(upper, body_hi),
    )


def _body_box(values: NDArray[Any]) -> NDArray[np.int64]:
    """First and one-past-last voxel index along x, y, z that is not air, shape (3, 2)."""
    box = _occupied_box(values)
    if box[0, 1] <= box[0, 0]:
        raise InputError(
            "The volume holds no tissue: every voxel is 0 (air). Check the labels, "
            "or relabel the volume with labels: {value: tissue}."
        )
    return box


@njit(cache=True, nogil=True)
def _occupied_box(values):  # type: ignore[no-untyped-def]
    nz, ny, nx = values.shape
    box = np.array([[nx, 0], [ny, 0], [nz, 0]])
    for k in range(nz):
        for j in range(ny):
            first = -1
            last = -1
            for i in range(nx):
                if values[k, j, i] != 0:
                    if first < 0:
                        first = i
                    last = i
            if first >= 0:
                box[0, 0] = min(box[0, 0], first)
                box[0, 1] = max(box[0, 1], last + 1)
                box[1, 0] = min(box[1, 0], j)
                box[1, 1] = max(box[1, 1], j + 1)
                box[2, 0] = min(box[2, 0], k)
                box[2, 1] = max(box[2, 1], k + 1)
    return box


@njit(cache=True, nogil=True)
def _block_mean(values, lo, hi, block):  # type: ignore[no-untyped-def]
    """Fraction of tissue in blocks of voxels that start at the corner ``lo`` of the body."""
    n = (hi - lo + block - 1) // block
    mean = np.zeros((n[2], n[1], n[0]), np.float32)
    for k in range(lo[2], hi[2]):
        bk = (k - lo[2]) // block[2]
        for j in range(lo[1], hi[1]):
            bj = (j - lo[1]) // block[1]
            for i in range(lo[0], hi[0]):
                if values[k, j, i] != 0:
                    mean[bk, bj, (i - lo[0]) // block[0]] += np.float32(1)
    full = np.float32(1.0 / (block[0] * block[1] * block[2]))
    for k in range(n[2]):
        for j in range(n[1]):
            for i in range(n[0]):
                mean[k, j, i] *= full
    return mean


def _one_solid_body(occupancy: NDArray[np.float32]) -> NDArray[np.float32]:
    """Largest connected piece, its enclosed cavities filled."""
    pieces, count = ndimage.label(occupancy > 0)
    if count > 1:
        largest = 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
        occupancy = np.where(pieces == largest, occupancy, np.float32(0))
    # Air that no path leads to from the box's outside; the wall side counts as closed.
    air = np.pad(occupancy < 0.5, ((0, 1), (1, 1), (1, 1)), constant_values=True)
    rooms, count = ndimage.label(air)
    if count > 1:
        cavity = ((rooms > 0) & (rooms != rooms[-1, 0, 0]))[:-1, 1:-1, 1:-1]
        near = ndimage.binary_dilation(cavity) & (occupancy > 0.5) | cavity
        open_air = ndimage.binary_dilation(rooms == rooms[-1, 0, 0])[:-1, 1:-1, 1:-1]
        occupancy = np.where(near & ~open_air, np.float32(1), occupancy)
    return occupancy


def _distance(
    occupancy: NDArray[np.float32], step: FloatArray
) -> tuple[NDArray[np.float32], float]:
    """Signed distance from block occupancy (see the top of the file)."""
    sigma = BLUR * float(step.max())
    blurred = occupancy
    for axis, length in zip((0, 1, 2), step[::-1], strict=True):
        # "nearest" continues the body straight through the wall; elsewhere there is only air.
        blurred = ndimage.gaussian_filter1d(
            blurred, sigma / length, axis=axis, mode="nearest", truncate=3.0
        )
    # A block adds its own width to the blur: variance step^2 / 12.
    spread = float(np.sqrt(sigma**2 + step.max() ** 2 / 12))
    field = np.full(blurred.shape, spread * -ndtri(SATURATION), np.float32)
    field[blurred > 0.5] *= -1
    band = (blurred > SATURATION) & (blurred < 1 - SATURATION)
    field[band] = -spread * ndtri(blurred[band])
    return field, float(blurred.sum(dtype=np.float64))


@njit(cache=True, nogil=True)
def distance_at(field, frame, x, y, z):  # type: ignore[no-untyped-def]
    """Trilinear value of the field at one point, continued constantly outside its box."""
    nz, ny, nx = field.shape
    u = min(max((x - frame[0, 0]) / frame[1, 0], 0.0), nx - 1.000001)
    v = min(max((y - frame[0, 1]) / frame[1, 1], 0.0), ny - 1.000001)
    w = min(max((z - frame[0, 2]) / frame[1, 2], 0.0), nz - 1.000001)
    i, j, k = int(u), int(v), int(w)
    u -= i
    v -= j
    w -= k
    f00 = field[k, j, i] * (1 - u) + field[k, j, i + 1] * u
    f01 = field[k, j + 1, i] * (1 - u) + field[k, j + 1, i + 1] * u
    f10 = field[k + 1, j, i] * (1 - u) + field[k + 1, j, i + 1] * u
    f11 = field[k + 1, j + 1, i] * (1 - u) + field[k + 1, j + 1, i + 1] * u
    return (f00 * (1 - v) + f01 * v) * (1 - w) + (f10 * (1 - v) + f11 * v) * w


@njit(cache=True, nogil=True)
def project(field, frame, point, level, on_wall, reach, out):  # type: ignore[no-untyped-def]
    """Move one point to the surface ``field = level`` along the gradient.

    A point of the wall stays in its plane. Returns whether the surface was met
    within ``reach`` mm; ``out`` then holds the place.
    """
    d = 0.35 * min(frame[1, 0], frame[1, 1], frame[1, 2])
    x, y, z = point[0], point[1], point[2]
    for _ in range(12):
        f = distance_at(field, frame, x, y, z) - level
        if abs(f) < 1e-4 * d:
            break
        gx = distance_at(field, frame, x + d, y, z) - distance_at(field, frame, x - d, y, z)
        gy = distance_at(field, frame, x, y + d, z) - distance_at(field, frame, x, y - d, z)
        gz = 0.0
        if not on_wall:
            gz = distance_at(field, frame, x, y, z + d) - distance_at(field, frame, x, y, z - d)
        gg = (gx * gx + gy * gy + gz * gz) / (4 * d * d)
        if gg < 0.01:
            return False
        scale = f / (gg * 2 * d)
        x -= scale * gx
        y -= scale * gy
        z -= scale * gz
        far = (x - point[0]) ** 2 + (y - point[1]) ** 2 + (z - point[2]) ** 2
        if far > reach * reach:
            return False
    if abs(distance_at(field, frame, x, y, z) - level) > 0.05 * d:
        return False
    out[0], out[1], out[2] = x, y, z
    return True
