"""Geometry of tetrahedral meshes: quality, elements around nodes, order of nodes, boundaries.

Nodes are numbered so that spatial neighbours are close in memory. The boundary consists of the
free surface and the wall.

Every measure of quality is 1 for the regular tetrahedron. M1..M4 and M5 are in [0, 1]; the
aspect ratio grows without bound as a tetrahedron degrades.

========  ====================================================================
M1        3 r / R, inscribed over circumscribed radius
M2        2 sqrt(6) r / longest edge
M3        12 (3 V)^(2/3) / sum of squared edges (mean ratio)
M4        smallest solid angle / 0.55129 sr (its value in the regular tetrahedron)
M5        smallest / largest volume; one number for a mesh
aspect    longest edge / shortest altitude / 1.2247
========  ====================================================================

References: Parthasarathy, Graichen and Hathaway, "A comparison of tetrahedron
quality measures", Finite Elem. Anal. Des. 15 (1994); Liu and Joe, "Relationship
between tetrahedron shape measures", BIT 34 (1994).
"""

from typing import TypedDict

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from palpate.storage.values import FloatArray, IntArray, TetMesh
from palpate.workers.kernels_and_threads import EXACT

PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # face i is opposite to node i
REGULAR_SOLID_ANGLE = float(3 * np.arccos(1 / 3) - np.pi)  # 0.55129 sr
REGULAR_ASPECT = float(np.sqrt(1.5))


def volumes_mm3(mesh: TetMesh) -> FloatArray:
    """Return signed volumes, shape (m,)."""
    x = mesh.nodes[mesh.tets]
    d = x[:, 1:] - x[:, :1]
    return np.einsum("mi,mi->m", d[:, 0], np.cross(d[:, 1], d[:, 2])) / 6


def measures(mesh: TetMesh) -> dict[str, FloatArray]:
    """Return M1 to M4, aspect ratio and volume of each tetrahedron, arrays of shape (m,)."""
    x = mesh.nodes[mesh.tets]
    volume = volumes_mm3(mesh)
    edge2 = np.stack([((x[:, a] - x[:, b]) ** 2).sum(axis=1) for a, b in PAIRS])
    area = np.stack(
        [
            0.5 * np.linalg.norm(np.cross(x[:, b] - x[:, a], x[:, c] - x[:, a]), axis=1)
            for a, b, c in FACES
        ]
    )
    longest = np.sqrt(edge2.max(axis=0))
    inscribed = 3 * volume / area.sum(axis=0)
    # Opposite edges are 0-5, 1-4, 2-3. R from their products (Crelle): 24 V R = 4 T, with T
    # the area of the triangle whose sides are the products.
    p = np.sort(np.sqrt(edge2[[0, 1, 2]] * edge2[[5, 4, 3]]), axis=0)[::-1]
    crelle = (
        (p[0] + (p[1] + p[2]))
        * np.maximum(p[2] - (p[0] - p[1]), 0)
        * (p[2] + (p[0] - p[1]))
        * (p[0] + (p[1] - p[2]))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        circumscribed = np.sqrt(crelle) / (24 * volume)
        return {
            "M1": 3 * inscribed / circumscribed,
            "M2": 2 * np.sqrt(6) * inscribed / longest,
            "M3": np.sign(volume) * 12 * (3 * np.abs(volume)) ** (2 / 3) / edge2.sum(axis=0),
            "M4": _smallest_solid_angle(x, volume) / REGULAR_SOLID_ANGLE,
            "aspect": longest * area.max(axis=0) / (3 * volume) / REGULAR_ASPECT,
            "volume_mm3": volume,
        }


def _smallest_solid_angle(x: FloatArray, volume: FloatArray) -> FloatArray:
    """Return the smallest of the four solid angles of each tetrahedron, in sr.

    Uses tan(angle / 2) of Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983).
    """
    smallest = np.full(len(x), np.inf)
    for corner in range(4):
        a, b, c = (x[:, (corner + k) % 4] - x[:, corner] for k in (1, 2, 3))
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        below = (
            la * lb * lc
            + np.einsum("mi,mi->m", a, b) * lc
            + np.einsum("mi,mi->m", a, c) * lb
            + np.einsum("mi,mi->m", b, c) * la
        )
        smallest = np.minimum(smallest, 2 * np.arctan2(6 * volume, below))
    return smallest


class Distribution(TypedDict):
    """Extremes, mean and percentiles of a measure over all tetrahedra."""

    min: float
    mean: float
    max: float
    p01: float
    p50: float
    p99: float


class MeshSummary(TypedDict):
    """Size and quality of a mesh, see `summarise`."""

    nodes: int
    tets: int
    volume_mm3: float
    M5: float
    bad: int
    M1: Distribution
    M2: Distribution
    M3: Distribution
    M4: Distribution
    aspect: Distribution


def summarise(mesh: TetMesh) -> MeshSummary:
    """Summarise size and quality of a mesh in plain numbers, ready for JSON.

    Returns
    -------
    MeshSummary
        ``nodes``, ``tets``, ``volume_mm3``, ``M5``, ``bad`` (tetrahedra of aspect ratio 10 or
        more) and for each of M1..M4 and the aspect ratio a dict of ``min``, ``mean``, ``max``
        and the percentiles ``p01``, ``p50``, ``p99``.
    """
    measured = measures(mesh)
    volume, aspect = measured["volume_mm3"], measured["aspect"]
    return MeshSummary(
        nodes=len(mesh.nodes),
        tets=len(mesh.tets),
        volume_mm3=float(volume.sum()),
        M5=float(volume.min() / volume.max()),
        bad=int(np.count_nonzero(aspect >= 10)),
        M1=_distribution(measured["M1"]),
        M2=_distribution(measured["M2"]),
        M3=_distribution(measured["M3"]),
        M4=_distribution(measured["M4"]),
        aspect=_distribution(aspect),
    )


def _distribution(values: FloatArray) -> Distribution:
    p01, p50, p99 = (float(v) for v in np.percentile(values, [1, 50, 99]))
    return Distribution(
        min=float(values.min()),
        mean=float(values.mean()),
        max=float(values.max()),
        p01=p01,
        p50=p50,
        p99=p99,
    )


@njit(**EXACT)
def elements_of_nodes(elements: IntArray, n: int) -> tuple[IntArray, IntArray]:
    """List the elements around each node, as compressed rows.

    Parameters
    ----------
    elements : ndarray of int32, shape (m, c)
        Nodes of edges, triangles or tetrahedra.
    n : int
        Number of nodes.

    Returns
    -------
    start : ndarray of int32, shape (n + 1,)
    content : ndarray of int32, shape (m c,)
        The elements of node i are ``content[start[i]:start[i + 1]]``, ascending.
    """
    m, corners = elements.shape
    start = np.zeros(n + 1, np.int32)
    for e in range(m):
        for c in range(corners):
            start[elements[e, c] + 1] += 1
    for v in range(n):
        start[v + 1] += start[v]
    fill = start[:-1].copy()
    content = np.empty(m * corners, np.int32)
    for e in range(m):
        for c in range(corners):
            v = elements[e, c]
            content[fill[v]] = e
            fill[v] += 1
    return start, content


def compacted(nodes: FloatArray, tets: IntArray) -> tuple[TetMesh, NDArray[np.bool_]]:
    """Return a mesh without its unused nodes, and which nodes it uses, shape (n,)."""
    used = np.zeros(len(nodes), np.bool_)
    used[tets] = True
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return TetMesh(nodes[used], number[tets]), used


def in_memory_order(mesh: TetMesh, step_mm: float) -> tuple[TetMesh, NDArray[np.int64]]:
    """Reorder a mesh so that spatial neighbours are close in memory.

    Nodes follow a Morton curve of cubes of ``step_mm``, tetrahedra follow their smallest node.

    Returns
    -------
    mesh : TetMesh
    rows : ndarray of int, shape (m,)
        The former row of each tetrahedron.
    """
    cell = ((mesh.nodes - mesh.nodes.min(axis=0)) / step_mm).astype(np.uint64)
    code = np.zeros(len(cell), np.uint64)
    for axis in range(3):
        code |= _spread_bits(cell[:, axis]) << np.uint64(axis)
    order = np.argsort(code, kind="stable").astype(np.int32)
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    tets = number[mesh.tets]
    rows = np.argsort(tets.min(axis=1), kind="stable")
    return TetMesh(mesh.nodes[order], np.ascontiguousarray(tets[rows])), rows


def _spread_bits(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put two zero bits between the lowest 21 bits."""
    value = value & np.uint64(0x1FFFFF)
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        value = (value | (value << np.uint64(shift))) & np.uint64(mask)
    return value


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
