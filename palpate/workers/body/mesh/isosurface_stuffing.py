"""Isosurface stuffing: fitting of a lattice's tetrahedra to an outline.

Lattice nodes too close to the outline are moved onto it; the edges that still cross it are cut
(F. Labelle and J. R. Shewchuk, "Isosurface stuffing", ACM Trans. Graph. 26(3), 2007, 57). A
tetrahedron then keeps its part inside the body: a smaller tetrahedron, a pyramid or a wedge,
split into tetrahedra. The diagonal of a cut face depends on that face alone, so neighbours
agree. Nodes of the wall move only within its plane.

A node is in front of the surface if its distance is negative, behind it if positive.
`workers.body.mesh.adaptive_cuts` fits meshes to a surface in the same way and keeps both sides.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh
from palpate.workers.body.mesh.bcc_lattice import Lattice
from palpate.workers.body.mesh.body_outline import Outline, distance_at, project
from palpate.workers.body.mesh.mesh_geometry import elements_of_nodes
from palpate.workers.kernels_and_threads import EXACT

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


@dataclass(frozen=True, eq=False)
class FittedEdges:
    """Nodes fitted to a surface, and the edges that it still cuts.

    Parameters
    ----------
    nodes : ndarray, shape (n + e, 3)
        The nodes of the mesh, some moved onto the surface, then the cut point of each edge.
    distance : ndarray, shape (n,)
        Distance of the nodes; 0 on the surface.
    edges : ndarray of int32, shape (e, 2)
        Node in front, node behind.
    start, incident : ndarray
        Edges of each node; see `elements_of_nodes`.
    """

    nodes: FloatArray
    distance: FloatArray
    edges: IntArray
    start: IntArray
    incident: IntArray


def fit_to_surface(
    mesh: TetMesh,
    distance: FloatArray,
    size_mm: FloatArray,
    fixed: BoolArray,
    on_wall: BoolArray,
    field: NDArray[np.float32],
    frame: FloatArray,
    level_mm: float = 0.0,
    *,
    both_sides: bool = False,
) -> FittedEdges:
    """Move nodes that are close to a surface onto it, and cut the edges that still cross it.

    Parameters
    ----------
    mesh : TetMesh
    distance : ndarray, shape (n,)
        Signed distance of the nodes.
    size_mm : ndarray, shape (n,)
        Size of the lattice around each node.
    fixed, on_wall : ndarray of bool, shape (n,)
        Nodes that must not move, and nodes that stay at their z.
    field, frame : ndarray
        Field of the distance, with its first sample and the step of its samples.
    level_mm : float
        Value of the field on the surface.
    both_sides : bool
        Both sides are kept: a node on the wall that is grazed by the surface is left as it is.
    """
    nodes, distance = mesh.nodes.copy(), distance.copy()
    distance[distance == 0] = 1e-9
    edges = crossing_edges(mesh.tets, distance)
    cut = _cut_fractions(nodes, distance, edges, field, frame, level_mm)
    start, incident = elements_of_nodes(edges, len(nodes))
    order = most_urgent_first(nodes, edges, cut, size_mm[edges].min(axis=1))
    _snap(
        nodes, distance, size_mm, fixed, on_wall, edges, cut, start, incident,
        order, field, frame, level_mm, both_sides,
    )  # fmt: skip
    alive = distance[edges[:, 0]] * distance[edges[:, 1]] < 0
    edges, cut = edges[alive], cut[alive]
    ends = nodes[edges]
    points = ends[:, 0] + cut[:, None] * (ends[:, 1] - ends[:, 0])
    start, incident = elements_of_nodes(edges, len(nodes))
    return FittedEdges(np.concatenate([nodes, points]), distance, edges, start, incident)


def stuff_isosurface(lattice: Lattice, outline: Outline) -> TetMesh:
    """Cut a lattice to an outline.

    Returns
    -------
    TetMesh
        Positively oriented tetrahedra that fill the outline; some nodes are unused.
    """
    size_mm = np.full(len(lattice.nodes), lattice.cell_mm)
    nobody = np.zeros(len(lattice.nodes), np.bool_)
    fitted = fit_to_surface(
        TetMesh(lattice.nodes, lattice.tets), lattice.distance, size_mm, nobody, lattice.wall,
        outline.field, outline.frame,
    )  # fmt: skip
    tets = _parts_in_front(
        lattice.tets, fitted.nodes, fitted.distance, fitted.edges, fitted.start, fitted.incident
    )
    wall = np.concatenate([lattice.wall, lattice.wall[fitted.edges].all(axis=1)])
    fitted.nodes[wall, 2] = outline.wall_z_mm
    return TetMesh(fitted.nodes, tets)


@njit(**EXACT)
def _cut_fractions(
    nodes: FloatArray,
    distance: FloatArray,
    edges: IntArray,
    field: NDArray[np.float32],
    frame: FloatArray,
    level: float,
) -> FloatArray:
    """Return the crossing of each edge, as a fraction from its negative node (Illinois rule)."""
    part = np.empty(len(edges))
    for e in range(len(edges)):
        p, q = nodes[edges[e, 0]], nodes[edges[e, 1]]
        t0, t1 = 0.0, 1.0
        f0, f1 = distance[edges[e, 0]], distance[edges[e, 1]]
        t, last = 0.5, 0
        for _ in range(30):
            t = t0 + (t1 - t0) * f0 / (f0 - f1)
            x = p + t * (q - p)
            f = distance_at(field, frame, x[0], x[1], x[2]) - level
            if abs(f) < 1e-5 or t1 - t0 < 1e-7:
                break
            if f < 0:
                t0, f0 = t, f
                f1 *= 0.5 if last == -1 else 1.0
                last = -1
            else:
                t1, f1 = t, f
                f0 *= 0.5 if last == 1 else 1.0
                last = 1
        part[e] = t
    return part


@njit(**EXACT)
def _snap(
    nodes: FloatArray,
    distance: FloatArray,
    size_mm: FloatArray,
    fixed: BoolArray,
    on_wall: BoolArray,
    edges: IntArray,
    part: FloatArray,
    start: IntArray,
    incident: IntArray,
    order: IntArray,
    field: NDArray[np.float32],
    frame: FloatArray,
    level: float,
    both_sides: bool,
) -> None:
    """Move nodes that are too close to the surface onto it; their distance becomes 0."""
    place = np.empty(3)
    for v in order:
        if fixed[v]:
            continue
        best, chosen, size = 1.0, -1, size_mm[v]
        for m in range(start[v], start[v + 1]):
            e = incident[m]
            p, q = edges[e, 0], edges[e, 1]
            if distance[p] * distance[q] >= 0:
                continue  # the other end has been moved onto the surface
            length = np.sqrt(squared_length(nodes, p, q))
            long = length > 0.95 * min(size_mm[p], size_mm[q])
            t = part[e] if p == v else 1.0 - part[e]
            if t < (NEAR_LONG if long else NEAR_SHORT) and t * length < best * size:
                best, chosen = t * length / size, e
        if chosen < 0:
            continue
        p, q = edges[chosen, 0], edges[chosen, 1]
        if project(field, frame, nodes[v], level, on_wall[v], 1.05 * best * size, place):
            nodes[v] = place
        elif not on_wall[v] or (on_wall[p] and on_wall[q]):
            nodes[v] = nodes[p] + part[chosen] * (nodes[q] - nodes[p])
        elif both_sides:
            continue
        # else: the surface grazes the wall here; the node stays and counts as being on it
        distance[v] = 0.0


@njit(**EXACT)
def _starts_at_first(
    nodes: FloatArray, distance: FloatArray, a: int, A: int, b: int, B: int, both_sides: bool
) -> bool:
    """Return True if the diagonal of the face (a, b, B, A) starts in a; A, B are cut points.

    It starts at the deeper node, or at the longer remainder. Each is an order, of the nodes or of
    the cut edges, so the three faces of a wedge never form a ring (which has no split without a
    new node). Only the first is the same seen from both sides.
    """
    if both_sides:
        da, db = abs(distance[a]), abs(distance[b])
        return da > db if da != db else a < b
    ra, rb = squared_length(nodes, a, A), squared_length(nodes, b, B)
    return ra > rb if ra != rb else A < B


@njit(**EXACT)
def add_one_side(
    tets: IntArray,
    count: int,
    tet: IntArray,
    sign: float,
    nodes: FloatArray,
    distance: FloatArray,
    edges: IntArray,
    start: IntArray,
    incident: IntArray,
    both_sides: bool,
) -> int:
    """Add the parts of a tetrahedron whose nodes have sign * distance < 0.

    Diagonals of cut faces go by the depth of their nodes if both sides are kept, and by what
    remains of the edges if one is.
    """
    first = len(distance)
    inn, out, on = np.empty(4, np.int64), np.empty(4, np.int64), np.empty(4, np.int64)
    n_in = n_out = n_on = 0
    for c in range(4):
        v, d = tet[c], sign * distance[tet[c]]
        if d < 0:
            inn[n_in] = v
            n_in += 1
        elif d > 0:
            out[n_out] = v
            n_out += 1
        else:
            on[n_on] = v
            n_on += 1
    if n_in == 0:
        return count
    if n_out == 0:
        return add_tet(tets, count, nodes, tet[0], tet[1], tet[2], tet[3])
    if n_in == 1:
        for c in range(n_out):
            on[n_on + c] = first + edge_between(edges, start, incident, inn[0], out[c])
        return add_tet(tets, count, nodes, inn[0], on[0], on[1], on[2])
    b, t, up = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.bool_)
    p, q = inn[0], inn[1]
    if n_in == 3:  # wedge between three nodes and their cut points
        for c in range(3):
            b[c] = inn[c]
            t[c] = first + edge_between(edges, start, incident, inn[c], out[0])
        for c in range(3):
            d = (c + 1) % 3
            up[c] = _starts_at_first(nodes, distance, b[c], t[c], b[d], t[d], both_sides)
        return add_wedge(tets, count, nodes, b, t, up)
    if n_out == 1:  # pyramid with its tip on the surface
        P = first + edge_between(edges, start, incident, p, out[0])
        Q = first + edge_between(edges, start, incident, q, out[0])
        if _starts_at_first(nodes, distance, p, P, q, Q, both_sides):
            count = add_tet(tets, count, nodes, p, q, Q, on[0])
            return add_tet(tets, count, nodes, p, Q, P, on[0])
        count = add_tet(tets, count, nodes, p, q, P, on[0])
        return add_tet(tets, count, nodes, q, Q, P, on[0])
    b[0], t[0] = p, q  # wedge along the edge between two nodes
    for c in range(2):
        b[c + 1] = first + edge_between(edges, start, incident, p, out[c])
        t[c + 1] = first + edge_between(edges, start, incident, q, out[c])
    up[0] = _starts_at_first(nodes, distance, p, b[1], q, t[1], both_sides)
    up[2] = not _starts_at_first(nodes, distance, p, b[2], q, t[2], both_sides)
    here, there = squared_length(nodes, b[1], t[2]), squared_length(nodes, b[2], t[1])
    up[1] = here < there
    if both_sides and here == there:  # seen from both sides, cut points have the same numbers
        up[1] = min(b[1], t[2]) < min(b[2], t[1])
    if up[0] == up[1] and up[1] == up[2]:
        up[1] = not up[1]
    return add_wedge(tets, count, nodes, b, t, up)


@njit(**EXACT)
def _parts_in_front(
    lattice_tets: IntArray,
    nodes: FloatArray,
    distance: FloatArray,
    edges: IntArray,
    start: IntArray,
    incident: IntArray,
) -> IntArray:
    tets = np.empty((3 * len(lattice_tets), 4), np.int32)
    count = 0
    for m in range(len(lattice_tets)):
        count = add_one_side(
            tets, count, lattice_tets[m], 1.0, nodes, distance, edges, start, incident, False
        )
    return tets[:count].copy()
