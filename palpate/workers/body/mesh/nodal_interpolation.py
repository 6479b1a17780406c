"""Interpolation of the nodal values of a mesh, at the nodes of a finer one and at material points.

A fine node inside the coarse mesh gets the barycentric mean of the tetrahedron around it.
Outside (the coarse outline cuts corners) the nearest tetrahedron is extrapolated linearly, but
no barycentric weight goes below -`FARTHEST`. Nodes of the wall only use coarse nodes of the
wall, so that components held on the coarse wall are also held on the fine one.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, TetMesh
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles, split_boundary
from palpate.workers.kernels_and_threads import EXACT

FARTHEST = 0.75  # in barycentric weight: this fraction of an altitude outside the tetrahedron


def prolongation(
    coarse: TetMesh, coarse_wall: IntArray, fine_nodes: FloatArray, fine_wall: IntArray
) -> csr_matrix:
    """Return the matrix that interpolates nodal values of a coarse mesh.

    Parameters
    ----------
    coarse : TetMesh
    coarse_wall, fine_wall : ndarray of int32
        Nodes on the chest wall.
    fine_nodes : ndarray, shape (n, 3)

    Returns
    -------
    csr_matrix, shape (n, n_coarse)
        Rows sum to 1; linear functions are exact except at nodes far outside.
    """
    n = len(fine_nodes)
    column = np.empty((n, 4), np.int64)
    weight = np.empty((n, 4))
    is_wall = np.zeros(n, np.bool_)
    is_wall[fine_wall] = True
    inner = np.flatnonzero(~is_wall)
    column[inner], weight[inner] = _interpolate(
        coarse.nodes[coarse.tets], coarse.tets, fine_nodes[inner]
    )
    if len(fine_wall):
        _, triangles = split_boundary(boundary_triangles(coarse.tets), coarse_wall)
        corners = np.zeros((len(triangles), 4, 3))
        corners[:, :3, :2] = coarse.nodes[triangles][:, :, :2]
        # An artificial tip one unit above the plane, with zero weight for points of the plane.
        corners[:, 3] = corners[:, 0] + np.array([0.0, 0.0, 1.0])
        lifted = np.column_stack([triangles, triangles[:, 0]])
        flat = fine_nodes[fine_wall] * np.array([1.0, 1.0, 0.0])
        column[fine_wall], weight[fine_wall] = _interpolate(corners, lifted, flat)
    row = np.repeat(np.arange(n), 4)
    keep = weight.ravel() != 0
    return csr_matrix(
        (weight.ravel()[keep], (row[keep], column.ravel()[keep])), shape=(n, len(coarse.nodes))
    )


def _interpolate(
    corners: FloatArray, tets: IntArray, points: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return nodes (n, 4) and weights (n, 4) of points, from ``corners`` (m, 4, 3) of elements."""
    inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
    low, high = corners.min(axis=1), corners.max(axis=1)
    bin_mm = float(np.median((high - low).max(axis=1)))
    corner = low.min(axis=0) - 0.5 * bin_mm
    shape = np.floor((high.max(axis=0) - corner) / bin_mm).astype(np.int64) + 1
    start, content = _bins(low, high, corner, shape, bin_mm)
    base = np.ascontiguousarray(corners[:, 0])
    chosen, weight = _locate(points, base, inverse, start, content, corner, shape, bin_mm)
    return tets[chosen].astype(np.int64), weight


@njit(**EXACT)
def _bins(
    low: FloatArray, high: FloatArray, corner: FloatArray, shape: NDArray[np.int64], bin_mm: float
) -> tuple[NDArray[np.int64], IntArray]:
    """List tetrahedra whose bounding box touches each cube of a grid, as compressed rows."""
    n_bins = shape[0] * shape[1] * shape[2]
    start = np.zeros(n_bins + 1, np.int64)
    content = np.empty(0, np.int32)
    fill = start[:-1].copy()
    for store in range(2):
        for m in range(len(low)):
            first = ((low[m] - corner) / bin_mm).astype(np.int64)
            last = ((high[m] - corner) / bin_mm).astype(np.int64)
            for k in range(first[2], last[2] + 1):
                for j in range(first[1], last[1] + 1):
                    for i in range(first[0], last[0] + 1):
                        b = i + shape[0] * (j + shape[1] * k)
                        if store:
                            content[fill[b]] = m
                            fill[b] += 1
                        else:
                            start[b + 1] += 1
        if not store:
            for b in range(n_bins):
                start[b + 1] += start[b]
            content = np.empty(start[n_bins], np.int32)
            fill = start[:-1].copy()
    return start, content


@njit(**EXACT)
def _locate(
    points: FloatArray,
    base: FloatArray,
    inverse: FloatArray,
    start: NDArray[np.int64],
    content: IntArray,
    corner: FloatArray,
    shape: NDArray[np.int64],
    bin_mm: float,
) -> tuple[NDArray[np.int64], FloatArray]:
    """Find the tetrahedron in which the smallest barycentric weight of each point is largest."""
    chosen = np.empty(len(points), np.int64)
    weight = np.empty((len(points), 4))
    cell = np.empty(3, np.int64)
    for p in range(len(points)):
        for c in range(3):
            cell[c] = min(max(int((points[p, c] - corner[c]) / bin_mm), 0), shape[c] - 1)
        best = -np.inf
        best_m = -1
        for ring in range(shape.max() + 1):
            for k in range(max(cell[2] - ring, 0), min(cell[2] + ring + 1, shape[2])):
                for j in range(max(cell[1] - ring, 0), min(cell[1] + ring + 1, shape[1])):
                    for i in range(max(cell[0] - ring, 0), min(cell[0] + ring + 1, shape[0])):
                        if max(abs(i - cell[0]), abs(j - cell[1]), abs(k - cell[2])) < ring:
                            continue
                        b = i + shape[0] * (j + shape[1] * k)
                        for a in range(start[b], start[b + 1]):
                            m = content[a]
                            least = _least_weight(points[p], base[m], inverse[m])
                            if least > best:
                                best = least
                                best_m = m
            # A point inside is found in the first ring; outside, one more ring is searched.
            if best >= 0 or (best_m >= 0 and ring > 0):
                break
        chosen[p] = best_m
        _weights(points[p], base[best_m], inverse[best_m], weight[p])
    return chosen, weight


@njit(**EXACT)
def _least_weight(x: FloatArray, base: FloatArray, inverse: FloatArray) -> float:
    dx, dy, dz = x[0] - base[0], x[1] - base[1], x[2] - base[2]
    w1 = inverse[0, 0] * dx + inverse[0, 1] * dy + inverse[0, 2] * dz
    w2 = inverse[1, 0] * dx + inverse[1, 1] * dy + inverse[1, 2] * dz
    w3 = inverse[2, 0] * dx + inverse[2, 1] * dy + inverse[2, 2] * dz
    return min(min(w1, w2), min(w3, 1.0 - w1 - w2 - w3))


@njit(**EXACT)
def _weights(x: FloatArray, base: FloatArray, inverse: FloatArray, weight: FloatArray) -> None:
    """Store barycentric weights, none below -`FARTHEST`, tiny ones dropped, sum 1."""
    total = 0.0
    for c in range(3):
        w = 0.0
        for d in range(3):
            w += inverse[c, d] * (x[d] - base[d])
        weight[c + 1] = w
        total += w
    weight[0] = 1.0 - total
    total = 0.0
    for c in range(4):
        if abs(weight[c]) < 1e-12:
            weight[c] = 0.0
        weight[c] = max(weight[c], -FARTHEST)
        total += weight[c]
    for c in range(4):
        weight[c] /= total


_NO_WALL = np.empty(0, np.int32)


def interpolation_at_points(
    mesh: TetMesh, points: FloatArray, farthest_mm: float = 5.0
) -> csr_matrix:
    """Return the interpolation matrix from nodal values to values at points.

    Parameters
    ----------
    mesh : TetMesh
        Mesh with n nodes.
    points : ndarray, shape (k, 3)
        (x, y, z) in mm, in the undeformed mesh or a little outside, where the nearest
        tetrahedron is extrapolated; see `workers.body.mesh.nodal_interpolation`.
    farthest_mm : float
        Largest distance of a point outside the range of that extrapolation.

    Returns
    -------
    csr_matrix, shape (k, n)
        Rows sum to 1. Linear fields are exact within the range of the extrapolation.

    Raises
    ------
    InputError
        If a point is farther outside, or its coordinates are not finite.
    """
    points = np.asarray(points, np.float64)
    if not np.isfinite(points).all():
        raise InputError("The coordinates of points in a mesh must be finite numbers, in mm.")
    matrix = prolongation(mesh, _NO_WALL, points, _NO_WALL)
    miss = np.linalg.norm(matrix @ mesh.nodes - points, axis=1)
    if miss.max(initial=0.0) > farthest_mm:
        raise InputError(
            f"{int(np.sum(miss > farthest_mm))} of {len(points)} points are more than "
            f"{farthest_mm:g} mm outside the mesh, the farthest by {miss.max():.1f} mm. "
            "Check that mesh and points come from the same scan."
        )
    return matrix
