"""Smoothing of the nodes of a graded mesh, with surfaces kept in place."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh
from palpate.workers.body.mesh.adaptive.level_set import LevelSet
from palpate.workers.body.mesh.incidence import elements_of_nodes
from palpate.workers.body.mesh.node_smoothing import _mean_ratio
from palpate.workers.body.mesh.outline import project
from palpate.workers.compile_flags import EXACT

# Badness of a tetrahedron is M3^-3: the worst ones count most. This value means inverted.
FLAT = 1e9


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints on the nodes.

    Parameters
    ----------
    skin, interface : LevelSet
        Outline of the body, and surface of the tissue inside it.
    skin_mm, interface_mm : float
        Values of the fields on the surfaces.
    on_skin, on_interface, on_wall : ndarray of bool, shape (n,)
        Nodes that stay on a surface, and at their z. A node on two surfaces is fixed.
    """

    skin: LevelSet
    interface: LevelSet
    skin_mm: float
    interface_mm: float
    on_skin: BoolArray
    on_interface: BoolArray
    on_wall: BoolArray


def smoothed(mesh: TetMesh, constraints: Constraints, sweeps: int) -> TetMesh:
    """Lower the sum of badness around each node, node by node.

    A node is tried at the mean of its neighbours, part of the way there, and along the axes,
    each time projected onto its surface, and stays at the best position.

    Parameters
    ----------
    mesh : TetMesh
    constraints : Constraints
    sweeps : int
        Number of visits to every node; nodes with good tetrahedra are skipped.
    """
    nodes = mesh.nodes.copy()
    start, around = elements_of_nodes(mesh.tets, len(nodes))
    c = constraints
    kind = np.zeros(len(nodes), np.int8)
    kind[c.on_skin] = 1
    kind[c.on_interface] = 2
    kind[c.on_skin & c.on_interface] = 3
    for sweep in range(sweeps):
        _sweep(
            nodes, mesh.tets, start, around, kind, c.on_wall, 0.15 * 0.7**sweep,
            c.skin.field, c.skin.frame, c.skin_mm,
            c.interface.field, c.interface.frame, c.interface_mm,
        )  # fmt: skip
    return TetMesh(nodes, mesh.tets)


def on_levels(mesh: TetMesh, constraints: Constraints, reach: FloatArray) -> TetMesh:
    """Move nodes back onto their surfaces, unless this degrades a tetrahedron.

    Parameters
    ----------
    mesh : TetMesh
    constraints : Constraints
    reach : ndarray, shape (n,)
        Longest move of each node in mm.
    """
    nodes = mesh.nodes.copy()
    start, around = elements_of_nodes(mesh.tets, len(nodes))
    c = constraints
    for level, mm, on in (
        (c.skin, c.skin_mm, c.on_skin & ~c.on_interface),
        (c.interface, c.interface_mm, c.on_interface & ~c.on_skin),
    ):
        _to_level(
            nodes, mesh.tets, start, around, on, c.on_wall, reach, level.field, level.frame, mm
        )
    return TetMesh(nodes, mesh.tets)


@njit(**EXACT)
def _badness(nodes: FloatArray, tets: IntArray, start: IntArray, around: IntArray, v: int) -> float:
    """Return the sum of M3^-3 = (sum of squared edges)^3 / 432 det^2 around a node."""
    total = 0.0
    for a in range(start[v], start[v + 1]):
        m = around[a]
        p, q, r, s = tets[m, 0], tets[m, 1], tets[m, 2], tets[m, 3]
        ax, ay, az = nodes[q, 0] - nodes[p, 0], nodes[q, 1] - nodes[p, 1], nodes[q, 2] - nodes[p, 2]
        bx, by, bz = nodes[r, 0] - nodes[p, 0], nodes[r, 1] - nodes[p, 1], nodes[r, 2] - nodes[p, 2]
        cx, cy, cz = nodes[s, 0] - nodes[p, 0], nodes[s, 1] - nodes[p, 1], nodes[s, 2] - nodes[p, 2]
        det = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        # (a-b)^2 + (b-c)^2 + (c-a)^2 = 3 (a^2 + b^2 + c^2) - (a + b + c)^2
        squares = ax * ax + ay * ay + az * az + bx * bx + by * by + bz * bz
        squares += cx * cx + cy * cy + cz * cz
        sx, sy, sz = ax + bx + cx, ay + by + cy, az + bz + cz
        edges = 4 * squares - sx * sx - sy * sy - sz * sz
        cube = edges * edges * edges
        if det > 0.0 and det * det > 1e-9 * cube:
            total += cube / (432.0 * det * det)
        else:
            total += FLAT
    return total


@njit(**EXACT)
def _worst(nodes: FloatArray, tets: IntArray, start: IntArray, around: IntArray, v: int) -> float:
    worst = 1.0
    for a in range(start[v], start[v + 1]):
        m = around[a]
        worst = min(worst, _mean_ratio(nodes, tets[m, 0], tets[m, 1], tets[m, 2], tets[m, 3]))
    return worst


@njit(**EXACT)
def _to_level(
    nodes: FloatArray,
    tets: IntArray,
    start: IntArray,
    around: IntArray,
    on: BoolArray,
    on_wall: BoolArray,
    reach: FloatArray,
    field: NDArray[np.float32],
    frame: FloatArray,
    level: float,
) -> None:
    place = np.empty(3)
    for v in range(len(nodes)):
        if not on[v] or not project(field, frame, nodes[v], level, on_wall[v], reach[v], place):
            continue
        before = _worst(nodes, tets, start, around, v)
        old = nodes[v].copy()
        for _ in range(4):  # halve the move while it is too large
            nodes[v] = place
            if _worst(nodes, tets, start, around, v) > min(0.9 * before, 0.3):
                break
            place = 0.5 * (place + old)
            nodes[v] = old


@njit(**EXACT)
def _sweep(
    nodes: FloatArray,
    tets: IntArray,
    start: IntArray,
    around: IntArray,
    kind: NDArray[np.int8],
    on_wall: BoolArray,
    step: float,
    skin: NDArray[np.float32],
    skin_frame: FloatArray,
    skin_mm: float,
    inner: NDArray[np.float32],
    inner_frame: FloatArray,
    inner_mm: float,
) -> None:
    trial, mean = np.empty(3), np.empty(3)
    for v in range(len(nodes)):
        if kind[v] == 3 or start[v] == start[v + 1]:
            continue
        badness = _badness(nodes, tets, start, around, v)
        # A lattice of equal cells has 1.06^3 = 1.2 at each tetrahedron.
        if badness < 1.25 * (start[v + 1] - start[v]):
            continue
        old, best = nodes[v].copy(), nodes[v].copy()
        mean[:] = 0.0
        size = 0.0
        for a in range(start[v], start[v + 1]):
            m = around[a]
            for c in range(4):
                w = tets[m, c]
                if w != v:
                    mean += nodes[w]
                    size += np.abs(nodes[w] - old).max()
        count = 3 * (start[v + 1] - start[v])
        mean = mean / count - old
        size /= count
        for move in range(9):
            if move < 3:
                trial[:] = old + mean * (1.0, 0.5, 0.2)[move]
            else:  # along the axes from the best place so far
                trial[:] = best
                trial[(move - 3) // 2] += step * size * (1.0 if move % 2 else -1.0)
            if on_wall[v]:
                trial[2] = old[2]
            if kind[v] == 1 and not project(
                skin, skin_frame, trial, skin_mm, on_wall[v], size, trial
            ):
                continue
            if kind[v] == 2 and not project(
                inner, inner_frame, trial, inner_mm, on_wall[v], size, trial
            ):
                continue
            nodes[v] = trial
            now = _badness(nodes, tets, start, around, v)
            if now < badness - 1e-6:
                badness = now
                best[:] = trial
        nodes[v] = best
