"""Fitting of tetrahedra to a surface: near nodes move onto it, remaining crossings are cut.

This is isosurface stuffing (F. Labelle and J. R. Shewchuk, ACM Trans. Graph. 26 (2007) 57)
with the tetrahedra of both sides kept. A face that is cut into a triangle and a quadrangle
gets the diagonal that starts at its deeper node. This is an order of the nodes, so the
three quadrangles of a wedge never form a ring, and both sides of a face agree.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh
from palpate.workers.body.mesh.adaptive.level_set import LevelSet
from palpate.workers.body.mesh.edge_cuts import (
    NEAR_LONG,
    NEAR_SHORT,
    add_tet,
    add_wedge,
    crossing_edges,
    edge_between,
    most_urgent_first,
    squared_length,
)
from palpate.workers.body.mesh.incidence import elements_of_nodes
from palpate.workers.body.mesh.outline import distance_at, project
from palpate.workers.compile_flags import EXACT


@dataclass(frozen=True, eq=False)
class Cut:
    """A mesh fitted to a surface.

    Parameters
    ----------
    mesh : TetMesh
        Positively oriented. Its first nodes are the nodes of the original mesh.
    inside : ndarray of bool, shape (m,)
        Tetrahedra on the negative side.
    on_surface : ndarray of bool, shape (n,)
    parent : ndarray of int32, shape (m,)
        The original tetrahedron of each part.
    new_ends : ndarray of int32, shape (k, 2)
        Ends of the edges that contain the last k nodes.
    """

    mesh: TetMesh
    inside: BoolArray
    on_surface: BoolArray
    parent: IntArray
    new_ends: IntArray


def cut(
    mesh: TetMesh,
    size_mm: FloatArray,
    surface: LevelSet,
    level_mm: float,
    fixed: BoolArray,
    on_wall: BoolArray,
) -> Cut:
    """Fit a mesh to a level of a field.

    Parameters
    ----------
    mesh : TetMesh
    size_mm : ndarray, shape (m,)
        Size of the lattice around each tetrahedron.
    surface : LevelSet
    level_mm : float
        Value of the field on the surface.
    fixed : ndarray of bool, shape (n,)
        Nodes that must not move.
    on_wall : ndarray of bool, shape (n,)
        Nodes that stay at their z.
    """
    nodes, field, frame = mesh.nodes.copy(), surface.field, surface.frame
    distance = _at_nodes(nodes, field, frame) - level_mm
    distance[distance == 0] = 1e-9
    edges = crossing_edges(mesh.tets, distance)
    part = _cut_fractions(nodes, distance, edges, field, frame, level_mm)
    lattice_mm = np.full(len(nodes), np.inf)
    np.minimum.at(lattice_mm, mesh.tets.ravel(), np.repeat(size_mm, 4))
    start, incident = elements_of_nodes(edges, len(nodes))
    order = most_urgent_first(nodes, edges, part, lattice_mm[edges].min(axis=1))
    _snap(
        nodes, distance, lattice_mm, fixed, on_wall, edges, part, start, incident,
        order, field, frame, level_mm,
    )  # fmt: skip
    alive = distance[edges[:, 0]] * distance[edges[:, 1]] < 0
    edges, part = edges[alive], part[alive]
    ends = nodes[edges]
    points = ends[:, 0] + part[:, None] * (ends[:, 1] - ends[:, 0])
    both_on_wall = on_wall[edges].all(axis=1)
    points[both_on_wall, 2] = ends[both_on_wall, 0, 2]
    start, incident = elements_of_nodes(edges, len(nodes))
    every = np.concatenate([nodes, points])
    tets, inside, parent = _both_sides(
        mesh.tets, every, distance, edges, start, incident, field, frame, level_mm
    )
    on = np.concatenate([distance == 0, np.ones(len(points), np.bool_)])
    return Cut(TetMesh(every, tets), inside, on, parent, edges)


@njit(**EXACT)
def _at_nodes(nodes: FloatArray, field: NDArray[np.float32], frame: FloatArray) -> FloatArray:
    found = np.empty(len(nodes))
    for v in range(len(nodes)):
        found[v] = distance_at(field, frame, nodes[v, 0], nodes[v, 1], nodes[v, 2])
    return found


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
    lattice_mm: FloatArray,
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
) -> None:
    """Move nodes that are too close to the surface onto it; their distance becomes 0."""
    place = np.empty(3)
    for v in order:
        if fixed[v]:
            continue
        best, chosen = np.inf, -1
        for m in range(start[v], start[v + 1]):
            e = incident[m]
            p, q = edges[e, 0], edges[e, 1]
            if distance[p] * distance[q] >= 0:
                continue  # the other end has been moved onto the surface
            length = np.sqrt(squared_length(nodes, p, q))
            long = length > 0.95 * min(lattice_mm[p], lattice_mm[q])
            t = part[e] if p == v else 1.0 - part[e]
            if t < (NEAR_LONG if long else NEAR_SHORT) and t * length < best:
                best, chosen = t * length, e
        if chosen < 0:
            continue
        if project(field, frame, nodes[v], level, on_wall[v], 1.05 * best, place):
            nodes[v] = place
        else:
            p, q = edges[chosen, 0], edges[chosen, 1]
            if on_wall[v] and not (on_wall[p] and on_wall[q]):
                continue  # the surface grazes the wall here
            nodes[v] = nodes[p] + part[chosen] * (nodes[q] - nodes[p])
        distance[v] = 0.0


@njit(**EXACT)
def _deeper(distance: FloatArray, p: int, q: int) -> bool:
    """Return True if the diagonal of a quadrangle starts at p, not q: an order of the nodes."""
    if abs(distance[p]) != abs(distance[q]):
        return abs(distance[p]) > abs(distance[q])
    return p < q


@njit(**EXACT)
def _one_side(
    tets: IntArray,
    count: int,
    tet: IntArray,
    sign: float,
    nodes: FloatArray,
    distance: FloatArray,
    edges: IntArray,
    start: IntArray,
    incident: IntArray,
) -> int:
    """Add the parts of a tetrahedron whose nodes have sign * distance < 0."""
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
            up[c] = _deeper(distance, b[c], b[(c + 1) % 3])
        return add_wedge(tets, count, nodes, b, t, up)
    if n_out == 1:  # pyramid with its tip on the surface
        P = first + edge_between(edges, start, incident, p, out[0])
        Q = first + edge_between(edges, start, incident, q, out[0])
        if not _deeper(distance, p, q):
            p, q, P, Q = q, p, Q, P
        count = add_tet(tets, count, nodes, p, q, Q, on[0])
        return add_tet(tets, count, nodes, p, Q, P, on[0])
    b[0], t[0] = p, q  # wedge along the edge between two nodes
    # Both sides name the four cut points in the same way: by lower negative and positive node.
    for c in range(2):
        b[c + 1] = first + edge_between(edges, start, incident, p, out[c])
        t[c + 1] = first + edge_between(edges, start, incident, q, out[c])
    up[0] = _deeper(distance, p, q)
    up[2] = not up[0]
    here, there = squared_length(nodes, b[1], t[2]), squared_length(nodes, b[2], t[1])
    up[1] = here < there
    if here == there:
        up[1] = min(b[1], t[2]) < min(b[2], t[1])
    return add_wedge(tets, count, nodes, b, t, up)


@njit(**EXACT)
def _both_sides(
    tets: IntArray,
    nodes: FloatArray,
    distance: FloatArray,
    edges: IntArray,
    start: IntArray,
    incident: IntArray,
    field: NDArray[np.float32],
    frame: FloatArray,
    level: float,
) -> tuple[IntArray, BoolArray, IntArray]:
    room = len(tets)
    for m in range(len(tets)):
        low = high = 0
        for c in range(4):
            low += distance[tets[m, c]] < 0
            high += distance[tets[m, c]] > 0
        if low and high:
            room += 5
    found = np.empty((room, 4), np.int32)
    inside, parent = np.empty(room, np.bool_), np.empty(room, np.int32)
    count = 0
    for m in range(len(tets)):
        tet = tets[m]
        before = count
        if distance[tet[0]] == distance[tet[1]] == distance[tet[2]] == distance[tet[3]] == 0:
            x = (nodes[tet[0]] + nodes[tet[1]] + nodes[tet[2]] + nodes[tet[3]]) / 4
            found[count] = tet
            inside[count] = distance_at(field, frame, x[0], x[1], x[2]) < level
            parent[count] = m
            count += 1
            continue
        for side in range(2):
            sign = 1.0 - 2.0 * side
            count = _one_side(found, count, tet, sign, nodes, distance, edges, start, incident)
            for new in range(before, count):
                inside[new] = side == 0
                parent[new] = m
            before = count
    return found[:count].copy(), inside[:count].copy(), parent[:count].copy()
