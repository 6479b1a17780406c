"""Isosurface stuffing: fitting of a lattice's tetrahedra to an outline.

Lattice nodes too close to the outline are moved onto it; the edges that still
cross it are cut (Labelle and Shewchuk, "Isosurface stuffing", ACM Trans. Graph.
26(3), 2007). A tetrahedron then keeps its part inside the body: a smaller
tetrahedron, a pyramid or a wedge, split into tetrahedra. The diagonal of a cut
face depends on that face alone, so neighbours agree. Nodes of the wall move
only within its plane.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh
from palpate.workers.body.mesh.bcc_lattice import Lattice
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
from palpate.workers.body.mesh.outline import Outline, distance_at, project
from palpate.workers.compile_flags import EXACT


def stuff_isosurface(lattice: Lattice, outline: Outline) -> TetMesh:
    """Cut a lattice to an outline.

    Returns
    -------
    TetMesh
        Positively oriented tetrahedra that fill the outline; some nodes are unused.
    """
    field, frame = outline.field, outline.frame
    nodes = lattice.nodes.copy()
    distance = lattice.distance.copy()
    distance[distance == 0] = 1e-9
    edges = crossing_edges(lattice.tets, distance)
    cut = _cut_fractions(nodes, distance, edges, field, frame)
    start, incident = elements_of_nodes(edges, len(nodes))
    order = most_urgent_first(nodes, edges, cut, lattice.cell_mm)
    _snap(
        nodes,
        distance,
        lattice.wall,
        edges,
        cut,
        start,
        incident,
        order,
        lattice.cell_mm,
        field,
        frame,
    )

    alive = distance[edges[:, 0]] * distance[edges[:, 1]] < 0
    edges, cut = edges[alive], cut[alive]
    ends = nodes[edges]
    points = ends[:, 0] + cut[:, None] * (ends[:, 1] - ends[:, 0])
    cut_wall = lattice.wall[edges].all(axis=1)
    start, incident = elements_of_nodes(edges, len(nodes))

    every = np.concatenate([nodes, points])
    tets = _cut_tets(lattice.tets, every, distance, edges, start, incident)
    wall = np.concatenate([lattice.wall, cut_wall])
    every[wall, 2] = outline.wall_z_mm
    return TetMesh(every, tets)


@njit(**EXACT)
def _cut_fractions(
    nodes: FloatArray,
    distance: FloatArray,
    edges: IntArray,
    field: NDArray[np.float32],
    frame: FloatArray,
) -> FloatArray:
    """Return the crossing of each edge, as a fraction from its inner node (Illinois rule)."""
    cut = np.empty(len(edges))
    for e in range(len(edges)):
        p, q = edges[e, 0], edges[e, 1]
        t0, t1, f0, f1 = 0.0, 1.0, distance[p], distance[q]
        t = 0.5
        side = 0
        for _ in range(30):
            t = t0 + (t1 - t0) * f0 / (f0 - f1)
            f = distance_at(
                field,
                frame,
                nodes[p, 0] + t * (nodes[q, 0] - nodes[p, 0]),
                nodes[p, 1] + t * (nodes[q, 1] - nodes[p, 1]),
                nodes[p, 2] + t * (nodes[q, 2] - nodes[p, 2]),
            )
            if abs(f) < 1e-5 or t1 - t0 < 1e-7:
                break
            if f < 0:
                t0, f0 = t, f
                if side == -1:
                    f1 *= 0.5
                side = -1
            else:
                t1, f1 = t, f
                if side == 1:
                    f0 *= 0.5
                side = 1
        cut[e] = t
    return cut


@njit(**EXACT)
def _snap(
    nodes: FloatArray,
    distance: FloatArray,
    wall: BoolArray,
    edges: IntArray,
    cut: FloatArray,
    start: IntArray,
    incident: IntArray,
    order: IntArray,
    cell_mm: float,
    field: NDArray[np.float32],
    frame: FloatArray,
) -> None:
    """Move nodes that are too close to the outline onto it; their distance becomes 0."""
    place = np.empty(3)
    for v in order:
        best = 1.0
        chosen = -1
        for m in range(start[v], start[v + 1]):
            e = incident[m]
            p, q = edges[e, 0], edges[e, 1]
            if distance[p] * distance[q] >= 0:
                continue  # the other end has been moved onto the outline
            length = np.sqrt(
                (nodes[p, 0] - nodes[q, 0]) ** 2
                + (nodes[p, 1] - nodes[q, 1]) ** 2
                + (nodes[p, 2] - nodes[q, 2]) ** 2
            )
            near = NEAR_LONG if length > 0.95 * cell_mm else NEAR_SHORT
            t = cut[e] if p == v else 1.0 - cut[e]
            if t < near and t * length < best * cell_mm:
                best = t * length / cell_mm
                chosen = e
        if chosen < 0:
            continue
        on_wall = wall[v]
        if project(field, frame, nodes[v], 0.0, on_wall, 1.05 * best * cell_mm, place):
            nodes[v] = place
        elif not on_wall or (wall[edges[chosen, 0]] and wall[edges[chosen, 1]]):
            p, q = edges[chosen, 0], edges[chosen, 1]
            nodes[v] = nodes[p] + cut[chosen] * (nodes[q] - nodes[p])
        # else: the outline grazes the wall here; the node stays and counts as being on it
        distance[v] = 0.0


@njit(**EXACT)
def _diagonal_starts_at_first(nodes: FloatArray, a: int, A: int, b: int, B: int) -> bool:
    """Return True if the diagonal of the face (a, b, B, A) starts in a; A, B are cut points.

    The diagonal starts at the longer remainder. This is an order of the cut edges, so the three
    faces of a wedge never form a ring (which has no split without a new node).
    """
    ra, rb = squared_length(nodes, a, A), squared_length(nodes, b, B)
    if ra != rb:
        return ra > rb
    return A < B


@njit(**EXACT)
def _cut_tets(
    lattice_tets: IntArray,
    nodes: FloatArray,
    distance: FloatArray,
    edges: IntArray,
    start: IntArray,
    incident: IntArray,
) -> IntArray:
    offset = len(distance)
    tets = np.empty((3 * len(lattice_tets), 4), np.int32)
    count = 0
    inn = np.empty(4, np.int64)
    out = np.empty(4, np.int64)
    on = np.empty(4, np.int64)
    b = np.empty(3, np.int64)
    t = np.empty(3, np.int64)
    up = np.empty(3, np.bool_)
    for m in range(len(lattice_tets)):
        n_in = n_out = n_on = 0
        for c in range(4):
            v = lattice_tets[m, c]
            if distance[v] < 0:
                inn[n_in] = v
                n_in += 1
            elif distance[v] > 0:
                out[n_out] = v
                n_out += 1
            else:
                on[n_on] = v
                n_on += 1
        if n_in == 0:
            continue
        if n_out == 0:
            tets[count] = lattice_tets[m]
            count += 1
        elif n_in == 1:
            c0 = inn[0]
            corner = on.copy()
            for c in range(n_out):
                corner[n_on + c] = offset + edge_between(edges, start, incident, c0, out[c])
            count = add_tet(tets, count, nodes, c0, corner[0], corner[1], corner[2])
        elif n_in == 2 and n_out == 1:  # pyramid with its tip on the outline
            p, q = inn[0], inn[1]
            P = offset + edge_between(edges, start, incident, p, out[0])
            Q = offset + edge_between(edges, start, incident, q, out[0])
            if _diagonal_starts_at_first(nodes, p, P, q, Q):
                count = add_tet(tets, count, nodes, p, q, Q, on[0])
                count = add_tet(tets, count, nodes, p, Q, P, on[0])
            else:
                count = add_tet(tets, count, nodes, p, q, P, on[0])
                count = add_tet(tets, count, nodes, q, Q, P, on[0])
        elif n_in == 3:  # wedge between three inner nodes and their cut points
            for c in range(3):
                b[c] = inn[c]
                t[c] = offset + edge_between(edges, start, incident, inn[c], out[0])
            for c in range(3):
                d = (c + 1) % 3
                up[c] = _diagonal_starts_at_first(nodes, b[c], t[c], b[d], t[d])
            count = add_wedge(tets, count, nodes, b, t, up)
        else:  # wedge along the edge between two inner nodes
            b[0], t[0] = inn[0], inn[1]
            for c in range(2):
                b[c + 1] = offset + edge_between(edges, start, incident, inn[0], out[c])
                t[c + 1] = offset + edge_between(edges, start, incident, inn[1], out[c])
            up[0] = _diagonal_starts_at_first(nodes, b[0], b[1], t[0], t[1])
            up[2] = not _diagonal_starts_at_first(nodes, b[0], b[2], t[0], t[2])
            up[1] = squared_length(nodes, b[1], t[2]) < squared_length(nodes, b[2], t[1])
            if up[0] == up[1] and up[1] == up[2]:
                up[1] = not up[1]
            count = add_wedge(tets, count, nodes, b, t, up)
    return tets[:count].copy()
