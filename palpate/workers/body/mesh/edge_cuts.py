"""Cutting of tetrahedra's edges at a surface, and assembly of tetrahedra from the parts.

A node is in front of the surface if its distance is negative, behind it if positive. Shared by
the two meshers that fit a lattice to a surface by isosurface stuffing (F. Labelle and
J. R. Shewchuk, ACM Trans. Graph. 26 (2007) 57).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.compile_flags import EXACT

# A node moves if an edge is cut closer to it than this fraction of the edge: the "safe"
# values of the paper's table 3 for edges of length a and sqrt(3)/2 a.
NEAR_LONG = 0.24999
NEAR_SHORT = 0.41189


def crossing_edges(tets: IntArray, distance: FloatArray) -> IntArray:
    """Return edges (node in front, node behind) that cross the surface, each once."""
    behind = distance[tets] > 0
    mixed = tets[behind.any(axis=1) & ~behind.all(axis=1)]
    pairs = mixed[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
    out = distance[pairs] > 0
    pairs = pairs[out[:, 0] != out[:, 1]]
    swap = distance[pairs[:, 0]] > 0
    pairs[swap] = pairs[swap][:, ::-1]
    key = np.unique(pairs[:, 0].astype(np.int64) * len(distance) + pairs[:, 1])
    return np.stack(np.divmod(key, len(distance)), axis=1).astype(np.int32)


def most_urgent_first(
    nodes: FloatArray, edges: IntArray, cut: FloatArray, cell_mm: FloatArray | float
) -> IntArray:
    """Return nodes whose nearest cut violates its limit, nearest first.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
    edges : ndarray, shape (e, 2)
    cut : ndarray, shape (e,)
        Position of each cut, as a fraction from the first node.
    cell_mm : float or ndarray, shape (e,)
        Size of the lattice around each edge.
    """
    length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    near = np.where(length > 0.95 * cell_mm, NEAR_LONG, NEAR_SHORT)
    urgency = np.full(len(nodes), np.inf)
    np.minimum.at(urgency, edges[:, 0], cut / near)
    np.minimum.at(urgency, edges[:, 1], (1 - cut) / near)
    close = np.flatnonzero(urgency < 1)
    return close[np.argsort(urgency[close], kind="stable")].astype(np.int32)


@njit(**EXACT)
def edge_between(edges: IntArray, start: IntArray, incident: IntArray, p: int, q: int) -> int:
    """Return the edge between two nodes, -1 if there is none."""
    for m in range(start[p], start[p + 1]):
        e = incident[m]
        if edges[e, 0] == q or edges[e, 1] == q:
            return e
    return -1


@njit(**EXACT)
def squared_length(nodes: FloatArray, p: int, q: int) -> float:
    """Return the squared distance of two nodes in mm^2."""
    return (
        (nodes[p, 0] - nodes[q, 0]) ** 2
        + (nodes[p, 1] - nodes[q, 1]) ** 2
        + (nodes[p, 2] - nodes[q, 2]) ** 2
    )


@njit(**EXACT)
def add_tet(tets: IntArray, count: int, nodes: FloatArray, p: int, q: int, r: int, s: int) -> int:
    """Append a tetrahedron of positive volume and return the new count."""
    x, y = nodes[q] - nodes[p], nodes[r] - nodes[p]
    z = nodes[s] - nodes[p]
    det = (
        x[0] * (y[1] * z[2] - y[2] * z[1])
        + x[1] * (y[2] * z[0] - y[0] * z[2])
        + x[2] * (y[0] * z[1] - y[1] * z[0])
    )
    tets[count, 0], tets[count, 1] = p, q
    if det > 0:
        tets[count, 2], tets[count, 3] = r, s
    else:
        tets[count, 2], tets[count, 3] = s, r
    return count + 1


@njit(**EXACT)
def add_wedge(
    tets: IntArray,
    count: int,
    nodes: FloatArray,
    b: NDArray[np.int64],
    t: NDArray[np.int64],
    up: BoolArray,
) -> int:
    """Split a wedge with corners b[0..2] below t[0..2] into three tetrahedra.

    ``up[i]`` means that the diagonal of the face between the columns i and i + 1 runs from b[i]
    to t[i + 1], else from b[i + 1] to t[i]; the three must not be equal.
    """
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        if up[i] and not up[k]:  # both diagonals at column i start in b[i]
            count = add_tet(tets, count, nodes, b[i], t[0], t[1], t[2])
            if up[j]:  # diagonal b[j] - t[k]
                count = add_tet(tets, count, nodes, b[i], b[j], t[j], t[k])
                return add_tet(tets, count, nodes, b[i], b[j], b[k], t[k])
            count = add_tet(tets, count, nodes, b[i], b[k], t[j], t[k])
            return add_tet(tets, count, nodes, b[i], b[j], b[k], t[j])
    return count
