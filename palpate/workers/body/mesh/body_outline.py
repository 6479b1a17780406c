"""The outline of a body as a smooth field, from its voxels, and the thickness of its skin.

Occupancy (labels other than air) is averaged over blocks of voxels, blurred with a Gaussian of
standard deviation ``s`` and converted to a distance: near a flat surface the blurred occupancy
is ``Phi(-d / s)`` with ``d`` the signed distance and ``Phi`` the normal distribution, so ``d =
-s Phi^-1(u)``. The field is linear across the surface, smooth below the size of a voxel,
negative inside, and saturates about 2.5 s away, where only its sign matters.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtri

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Triple, Volume
from palpate.workers.kernels_and_threads import EXACT

BLUR = 0.9  # blur in grid steps; less leaves the voxels' staircase, more rounds the rim
MARGIN = 6  # samples of air around the body
SATURATION = 0.006  # occupancy at which the distance is clipped (2.5 standard deviations)


@dataclass(frozen=True, eq=False)
class Outline:
    """Signed distance to the skin of a body that ends at the plane of the chest wall.

    Parameters
    ----------
    field : ndarray of float32, shape (nz, ny, nx)
        Signed distance in mm, negative inside; continued straight below the wall.
    origin_mm, step_mm : tuple of float
        Position (x, y, z) of ``field[0, 0, 0]`` and distance of the samples.
    wall_z_mm : float
        Lower face of the body's lowest voxels.
    volume_mm3 : float
        Volume of the body's voxels, including enclosed cavities.
    free_area_mm2 : float
        Area of the outline without the wall.
    lower_mm, upper_mm : ndarray, shape (3,)
        Bounding box of the body.
    """

    field: NDArray[np.float32]
    origin_mm: Triple
    step_mm: Triple
    wall_z_mm: float
    volume_mm3: float
    free_area_mm2: float
    lower_mm: FloatArray
    upper_mm: FloatArray

    @property
    def smallest_extent_mm(self) -> float:
        """Return the shortest side of the bounding box."""
        return float(np.min(self.upper_mm - self.lower_mm))

    @property
    def frame(self) -> FloatArray:
        """Return origin and step in one array of shape (2, 3), as used by the kernels."""
        return np.array([self.origin_mm, self.step_mm])


def outline_of(labels: Volume, step_mm: float) -> Outline:
    """Find the outline of the largest connected body in a label volume.

    Pieces are separated, and cavities filled, at the resolution of the samples; a pocket that
    opens into the wall is not a cavity.

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
    spacing = np.asarray(labels.spacing_mm, np.float64)
    block = np.maximum(1, np.rint(step_mm / spacing)).astype(np.int64)
    occupancy, box = _body_occupancy(labels, block)

    step: FloatArray = spacing * block
    lower, upper = np.asarray(labels.origin_mm) + (box - 0.5) * spacing
    origin = lower + 0.5 * step - np.array([MARGIN, MARGIN, 0]) * step
    padded = np.pad(occupancy, ((0, MARGIN), (MARGIN, MARGIN), (MARGIN, MARGIN)))
    field, area = _distance(padded, step)
    return Outline(
        field=field,
        origin_mm=(float(origin[0]), float(origin[1]), float(origin[2])),
        step_mm=(float(step[0]), float(step[1]), float(step[2])),
        wall_z_mm=float(lower[2]),
        volume_mm3=float(occupancy.sum(dtype=np.float64) * np.prod(step)),
        free_area_mm2=area,
        lower_mm=lower,
        upper_mm=upper,
    )


def _body_occupancy(
    labels: Volume, block: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the occupancy of the blocks of the largest body and its box of voxels (2, 3).

    Blocks start at the body's own lowest voxels, so that the wall is a face of blocks: if
    smaller pieces extend the box, it is computed again for the body alone.
    """
    box = _occupied_box(labels.values, np.array([(0, 0, 0), labels.shape_xyz], np.int64))
    if box[1, 0] <= box[0, 0]:
        raise InputError(
            "The volume has no tissue: every voxel is 0 (air). Check the labels, "
            "or relabel the volume with labels: {value: tissue}."
        )
    for _ in range(4):
        occupancy = _one_solid_body(_block_mean(labels.values, box, block))
        filled = np.nonzero(occupancy)
        blocks = np.array([[a.min(), a.max() + 1] for a in reversed(filled)]).T
        around = np.minimum(box[0] + blocks * block, box[1])
        body_box = _occupied_box(labels.values, np.ascontiguousarray(around))
        if np.array_equal(body_box, box):
            break
        box = body_box
    return occupancy, box


@njit(**EXACT)
def _occupied_box(values: NDArray[np.generic], within: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the first and one-past-last voxel (x, y, z) inside a box that is not air, (2, 3)."""
    box = np.empty((2, 3), np.int64)
    box[0] = within[1]
    box[1] = within[0]
    for k in range(within[0, 2], within[1, 2]):
        for j in range(within[0, 1], within[1, 1]):
            first = -1
            last = -1
            for i in range(within[0, 0], within[1, 0]):
                if values[k, j, i] != 0:
                    if first < 0:
                        first = i
                    last = i
            if first >= 0:
                box[0, 0] = min(box[0, 0], first)
                box[1, 0] = max(box[1, 0], last + 1)
                box[0, 1] = min(box[0, 1], j)
                box[1, 1] = max(box[1, 1], j + 1)
                box[0, 2] = min(box[0, 2], k)
                box[1, 2] = max(box[1, 2], k + 1)
    return box


@njit(**EXACT)
def _block_mean(
    values: NDArray[np.generic], box: NDArray[np.int64], block: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Return the fraction of tissue in blocks of voxels, from the lower corner of a box."""
    n = (box[1] - box[0] + block - 1) // block
    mean = np.zeros((n[2], n[1], n[0]), np.float32)
    for k in range(box[0, 2], box[1, 2]):
        bk = (k - box[0, 2]) // block[2]
        for j in range(box[0, 1], box[1, 1]):
            bj = (j - box[0, 1]) // block[1]
            for bi in range(n[0]):
                start = box[0, 0] + bi * block[0]
                count = 0
                for i in range(start, min(start + block[0], box[1, 0])):
                    if values[k, j, i] != 0:
                        count += 1
                mean[bk, bj, bi] += np.float32(count)
    full = np.float32(block[0] * block[1] * block[2])
    for k in range(n[2]):
        for j in range(n[1]):
            for i in range(n[0]):
                mean[k, j, i] /= full
    return mean


def _one_solid_body(occupancy: NDArray[np.float32]) -> NDArray[np.float32]:
    """Keep the largest connected piece and fill its enclosed cavities."""
    pieces, count = ndimage.label(occupancy > 0)
    if count > 1:
        largest = 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
        occupancy = np.where(pieces == largest, occupancy, np.float32(0))
    rooms, count = ndimage.label(np.pad(occupancy < 0.5, 1, constant_values=True))
    if count > 1:
        inner = (slice(1, -1),) * 3
        outdoors = rooms[0, 0, 0]
        cavity = ndimage.binary_dilation((rooms > 0) & (rooms != outdoors))[inner]
        skin = ndimage.binary_dilation(rooms == outdoors)[inner]
        occupancy = np.where(cavity & ~skin, np.float32(1), occupancy)
    return occupancy


def _distance(
    occupancy: NDArray[np.float32], step: FloatArray
) -> tuple[NDArray[np.float32], float]:
    """Return the signed distance (see the module docstring) and the free area."""
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
    return field, _total_variation(blurred, step)


@njit(**EXACT)
def _total_variation(u: NDArray[np.float32], step: FloatArray) -> float:
    """Return the integral of the slope of ``u``, the area across which it falls from 1 to 0."""
    nz, ny, nx = u.shape
    total = 0.0
    for k in range(nz):
        for j in range(1, ny - 1):
            for i in range(1, nx - 1):
                above, below = u[min(k + 1, nz - 1), j, i], u[max(k - 1, 0), j, i]
                gx = (u[k, j, i + 1] - u[k, j, i - 1]) / (2 * step[0])
                gy = (u[k, j + 1, i] - u[k, j - 1, i]) / (2 * step[1])
                gz = (above - below) / (2 * step[2])
                total += np.sqrt(gx * gx + gy * gy + gz * gz)
    return total * step[0] * step[1] * step[2]


@njit(**EXACT)
def distance_at(
    field: NDArray[np.float32], frame: FloatArray, x: float, y: float, z: float
) -> float:
    """Interpolate the field at one point trilinearly; it is constant outside its box."""
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


@njit(**EXACT)
def project(
    field: NDArray[np.float32],
    frame: FloatArray,
    point: FloatArray,
    level: float,
    on_wall: bool,
    reach: float,
    out: FloatArray,
) -> bool:
    """Move one point to the surface ``field = level`` along the gradient.

    A point of the wall stays in its plane. Return True if the surface is reached
    within ``reach`` mm; ``out`` then contains the position.
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


def skin_thickness_mm(labels: Volume) -> float:
    """Return the mean thickness: skin volume over free area of the body; 0 without skin."""
    skin_mm3 = np.count_nonzero(labels.values == Tissue.SKIN) * labels.voxel_mm3
    if not skin_mm3:
        return 0.0
    longest = float(np.max(np.asarray(labels.shape_xyz) * labels.spacing_mm))
    return skin_mm3 / outline_of(labels, longest / 150).free_area_mm2
