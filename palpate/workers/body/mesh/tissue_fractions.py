"""Tissue of the tetrahedra of a mesh.

The finest mesh samples five points, the four nodes and the centroid, and uses the
majority; coarser ones use volume fractions.
Air is never counted: the mesh fills the body, so air between voxel faces and
the smooth outline is tissue.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.kernels_and_threads import EXACT

N_TISSUES = len(Tissue)
NUDGE = 1e-3  # nodes are sampled this fraction towards the centroid, to avoid voxel faces


def majority_fractions(mesh: TetMesh, labels: Volume) -> NDArray[np.float32]:
    """Return the one-hot tissue of each tetrahedron by the vote of its nodes and centroid.

    A tie goes to the centroid's tissue, or, if that is not among the first, to the lower label.
    If all five are in air the nearest tissue is used.

    Returns
    -------
    ndarray of float32, shape (m, 6)
    """
    values = _checked(labels)
    tissue = _vote(mesh.nodes, mesh.tets, values, *_frame(labels))
    fractions = np.zeros((len(tissue), N_TISSUES), np.float32)
    fractions[np.arange(len(tissue)), tissue] = 1
    return fractions


def volume_fractions(mesh: TetMesh, labels: Volume) -> NDArray[np.float32]:
    """Return the volume fraction of each tissue in each tetrahedron.

    Labels are sampled at 256 evenly spread points; the fractions are accurate to about 0.02.

    Returns
    -------
    ndarray of float32, shape (m, 6)
        Rows sum to 1; the column of air is 0.
    """
    values = _checked(labels)
    return _sample(mesh.nodes, mesh.tets, values, *_frame(labels))


def _spread_points(count: int) -> FloatArray:
    """Return barycentric weights (count, 4) of points spread evenly through a tetrahedron.

    A Kronecker sequence in the unit cube (steps g^-1, g^-2, g^-3 with g^4 = g + 1), folded into
    the tetrahedron that is a sixth of it (Rocchini and Cignoni, J. Graphics Tools 5(4), 2000).
    """
    g = 1.2207440846057596
    x, y, z = (0.5 + np.arange(1, count + 1)[:, None] * g ** -np.arange(1.0, 4.0)).T % 1
    fold = x + y > 1
    x, y = np.where(fold, 1 - x, x), np.where(fold, 1 - y, y)
    high, steep = y + z > 1, x + y + z > 1
    x, y, z = (
        np.where(high, x, np.where(steep, 1 - y - z, x)),
        np.where(high, 1 - z, y),
        np.where(high, 1 - x - y, np.where(steep, x + y + z - 1, z)),
    )
    return np.ascontiguousarray(np.stack([1 - x - y - z, x, y, z], axis=1))


POINTS = _spread_points(256)


def _checked(labels: Volume) -> NDArray[np.uint8]:
    """Return labels as the kernels index them: bytes, none above the last tissue."""
    values = labels.values
    if values.dtype.kind not in "biu":
        raise InputError(
            f"Tissue labels must be whole numbers, got {values.dtype}. Relabel the volume first."
        )
    low, high = int(values.min()), int(values.max())
    if low < 0 or high >= N_TISSUES:
        raise InputError(
            f"Tissue labels must be from 0 to {N_TISSUES - 1}, got {low} to {high}. "
            "Relabel the volume with labels: {value: tissue}."
        )
    return values if values.dtype == np.uint8 else values.astype(np.uint8)


def _frame(labels: Volume) -> tuple[FloatArray, FloatArray]:
    """Return the corner of the box of voxels and 1 / spacing, along x, y, z."""
    spacing = np.asarray(labels.spacing_mm, np.float64)
    return np.asarray(labels.origin_mm, np.float64) - 0.5 * spacing, 1 / spacing


@njit(**EXACT)
def _label_at(
    values: NDArray[np.uint8], corner: FloatArray, per_mm: FloatArray, x: float, y: float, z: float
) -> int:
    nz, ny, nx = values.shape
    i = int(np.floor((x - corner[0]) * per_mm[0]))
    j = int(np.floor((y - corner[1]) * per_mm[1]))
    k = int(np.floor((z - corner[2]) * per_mm[2]))
    if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
        return 0
    return int(values[k, j, i])


@njit(**EXACT)
def _nearest_tissue(
    values: NDArray[np.uint8], corner: FloatArray, per_mm: FloatArray, x: float, y: float, z: float
) -> int:
    """Return the tissue of the nearest voxel that is not air within 12 voxels, else fat."""
    nz, ny, nx = values.shape
    u, v, w = (x - corner[0]) * per_mm[0], (y - corner[1]) * per_mm[1], (z - corner[2]) * per_mm[2]
    voxel = (int(np.floor(u)), int(np.floor(v)), int(np.floor(w)))
    best = np.inf
    tissue = 1
    for ring in range(1, 13):
        for k in range(max(voxel[2] - ring, 0), min(voxel[2] + ring + 1, nz)):
            for j in range(max(voxel[1] - ring, 0), min(voxel[1] + ring + 1, ny)):
                for i in range(max(voxel[0] - ring, 0), min(voxel[0] + ring + 1, nx)):
                    label = values[k, j, i]
                    if label == 0:
                        continue
                    far = (
                        ((i + 0.5 - u) / per_mm[0]) ** 2
                        + ((j + 0.5 - v) / per_mm[1]) ** 2
                        + ((k + 0.5 - w) / per_mm[2]) ** 2
                    )
                    if far < best:
                        best = far
                        tissue = int(label)
        if best < np.inf:
            break
    return tissue


@njit(**EXACT)
def _vote(
    nodes: FloatArray,
    tets: IntArray,
    values: NDArray[np.uint8],
    corner: FloatArray,
    per_mm: FloatArray,
) -> NDArray[np.int64]:
    tissue = np.empty(len(tets), np.int64)
    votes = np.empty(N_TISSUES, np.int64)
    for m in range(len(tets)):
        votes[:] = 0
        middle = (nodes[tets[m, 0]] + nodes[tets[m, 1]] + nodes[tets[m, 2]] + nodes[tets[m, 3]]) / 4
        for c in range(4):
            x = nodes[tets[m, c]] + NUDGE * (middle - nodes[tets[m, c]])
            votes[_label_at(values, corner, per_mm, x[0], x[1], x[2])] += 1
        centre = _label_at(values, corner, per_mm, middle[0], middle[1], middle[2])
        votes[centre] += 1
        votes[0] = 0
        winner = int(np.argmax(votes))
        if votes[centre] == votes[winner]:
            winner = centre
        if winner == 0:
            winner = _nearest_tissue(values, corner, per_mm, middle[0], middle[1], middle[2])
        tissue[m] = winner
    return tissue


@njit(**EXACT)
def _sample(
    nodes: FloatArray,
    tets: IntArray,
    values: NDArray[np.uint8],
    corner: FloatArray,
    per_mm: FloatArray,
) -> NDArray[np.float32]:
    fractions = np.zeros((len(tets), N_TISSUES), np.float32)
    votes = np.empty(N_TISSUES, np.int64)
    for m in range(len(tets)):
        a, b, c, d = nodes[tets[m, 0]], nodes[tets[m, 1]], nodes[tets[m, 2]], nodes[tets[m, 3]]
        votes[:] = 0
        for p in range(len(POINTS)):
            wa, wb, wc, wd = POINTS[p, 0], POINTS[p, 1], POINTS[p, 2], POINTS[p, 3]
            x = wa * a[0] + wb * b[0] + wc * c[0] + wd * d[0]
            y = wa * a[1] + wb * b[1] + wc * c[1] + wd * d[1]
            z = wa * a[2] + wb * b[2] + wc * c[2] + wd * d[2]
            votes[_label_at(values, corner, per_mm, x, y, z)] += 1
        votes[0] = 0
        total = votes.sum()
        if total == 0:
            middle = (a + b + c + d) / 4
            fractions[
                m, _nearest_tissue(values, corner, per_mm, middle[0], middle[1], middle[2])
            ] = 1
        else:
            for t in range(N_TISSUES):
                fractions[m, t] = votes[t] / total
    return fractions
