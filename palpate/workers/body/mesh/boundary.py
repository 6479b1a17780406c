"""Boundaries of tetrahedral meshes: free surface, wall and areas."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.body.mesh.quality import FACES, PAIRS
from palpate.workers.compile_flags import EXACT


def boundary_triangles(tets: IntArray) -> IntArray:
    """Return faces that belong to a single tetrahedron, outward oriented, shape (k, 3) int32."""
    faces, _, single = _faces(tets)
    return faces[single]


def _faces(tets: IntArray) -> tuple[IntArray, NDArray[np.int64], NDArray[np.int64]]:
    """Return all faces (4 m, 3), the coincident pairs (p, 2), and the single ones."""
    faces = np.ascontiguousarray(tets[:, FACES].reshape(-1, 3))
    pairs, single = _pair_faces(faces, int(tets.max()) + 1)
    return faces, pairs, single


@njit(**EXACT)
def _pair_faces(faces: IntArray, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pair equal faces and list single ones: compare the faces that share their smallest node."""
    m = len(faces)
    start = np.zeros(n + 1, np.int64)
    key = np.empty((m, 3), np.int32)
    for f in range(m):
        p, q, r = faces[f, 0], faces[f, 1], faces[f, 2]
        low, high = min(p, q, r), max(p, q, r)
        key[f, 0], key[f, 1], key[f, 2] = low, p + q + r - low - high, high
        start[low + 1] += 1
    for v in range(n):
        start[v + 1] += start[v]
    fill = start[:-1].copy()
    bucket = np.empty(m, np.int64)
    for f in range(m):
        bucket[fill[key[f, 0]]] = f
        fill[key[f, 0]] += 1
    pairs = np.empty((m // 2, 2), np.int64)
    matched = np.zeros(m, np.bool_)
    count = 0
    for v in range(n):
        for a in range(start[v], start[v + 1]):
            f = bucket[a]
            if matched[f]:
                continue
            for b in range(a + 1, start[v + 1]):
                g = bucket[b]
                if key[f, 1] == key[g, 1] and key[f, 2] == key[g, 2]:
                    pairs[count, 0], pairs[count, 1] = f, g
                    matched[f] = True
                    matched[g] = True
                    count += 1
                    break
    return pairs[:count].copy(), np.flatnonzero(~matched)


def largest_piece(tets: IntArray) -> NDArray[np.bool_]:
    """Return a mask of the tetrahedra of the largest piece connected by faces."""
    _, pairs, _ = _faces(tets)
    m = len(tets)
    owner = pairs // 4
    graph = coo_matrix((np.ones(len(owner), np.int8), (owner[:, 0], owner[:, 1])), shape=(m, m))
    count, piece = connected_components(graph, directed=False)
    if count == 1:
        return np.ones(m, np.bool_)
    return piece == np.argmax(np.bincount(piece))


def without_nonmanifold_edges(tets: IntArray) -> IntArray:
    """Remove all but the largest piece of a mesh, and non-manifold edges of its boundary.

    In a rough outline two parts may touch only along an edge, with four boundary triangles
    around it. The tetrahedra at such edges are removed, until there are none.
    """
    tets = tets[largest_piece(tets)]
    while True:
        nonmanifold = _nonmanifold_edges(boundary_triangles(tets))
        if not len(nonmanifold):
            return tets
        pairs = np.sort(tets[:, PAIRS].reshape(-1, 2), axis=1)
        key, bad = (p[:, 0].astype(np.int64) << 32 | p[:, 1] for p in (pairs, nonmanifold))
        tets = tets[~np.isin(key, bad).reshape(-1, len(PAIRS)).any(axis=1)]
        tets = tets[largest_piece(tets)]


def _nonmanifold_edges(triangles: IntArray) -> IntArray:
    """Find edges of a closed surface at which more than two triangles meet, shape (e, 2)."""
    pairs = np.sort(triangles[:, ((0, 1), (1, 2), (2, 0))].reshape(-1, 2), axis=1)
    edges, count = np.unique(pairs, axis=0, return_counts=True)
    return edges[count > 2]


def wall_nodes(nodes: FloatArray, wall_z_mm: float) -> IntArray:
    """Return the nodes in the plane of the chest wall."""
    return np.flatnonzero(nodes[:, 2] == wall_z_mm).astype(np.int32)


def split_boundary(triangles: IntArray, wall: IntArray) -> tuple[IntArray, IntArray]:
    """Split boundary triangles into (free surface, wall)."""
    n = int(triangles.max()) + 1
    on_wall = np.zeros(max(n, int(wall.max()) + 1 if len(wall) else 0), np.bool_)
    on_wall[wall] = True
    flat = on_wall[triangles].all(axis=1)
    return triangles[~flat], triangles[flat]


def triangle_areas_mm2(nodes: FloatArray, triangles: IntArray) -> FloatArray:
    """Return the areas of triangles, shape (k,)."""
    x = nodes[triangles]
    return 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)


def nodal_areas_mm2(nodes: FloatArray, triangles: IntArray) -> FloatArray:
    """Return a third of the area of the triangles around each node, shape (n,)."""
    share = np.repeat(triangle_areas_mm2(nodes, triangles) / 3, 3)
    sums = np.bincount(triangles.ravel(), weights=share, minlength=len(nodes))
    return np.asarray(sums, np.float64)
