"""Improvement of the worst tetrahedra by small moves of their nodes."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh
from palpate.workers.body.mesh.incidence import elements_of_nodes
from palpate.workers.body.mesh.outline import Outline, project
from palpate.workers.compile_flags import EXACT


def improve_shape(
    mesh: TetMesh,
    skin: NDArray[np.bool_],
    on_wall: NDArray[np.bool_],
    level_mm: float,
    cell_mm: float,
    outline: Outline,
    passes: int = 4,
    good: float = 0.7,
) -> TetMesh:
    """Move nodes around tetrahedra whose M3 is below ``good`` if that improves the worst one.

    Nodes of the skin stay on the level ``level_mm`` of the outline, nodes of the wall in its
    plane.
    """
    nodes = mesh.nodes.copy()
    start, around = elements_of_nodes(mesh.tets, len(nodes))
    _improve(
        nodes,
        mesh.tets,
        start,
        around,
        skin,
        on_wall,
        level_mm,
        cell_mm,
        passes,
        good,
        outline.field,
        outline.frame,
    )
    return TetMesh(nodes, mesh.tets)


@njit(**EXACT)
def _mean_ratio(nodes: FloatArray, p: int, q: int, r: int, s: int) -> float:
    """Return M3 of one tetrahedron, negative if it is inverted."""
    ax, ay, az = nodes[q, 0] - nodes[p, 0], nodes[q, 1] - nodes[p, 1], nodes[q, 2] - nodes[p, 2]
    bx, by, bz = nodes[r, 0] - nodes[p, 0], nodes[r, 1] - nodes[p, 1], nodes[r, 2] - nodes[p, 2]
    cx, cy, cz = nodes[s, 0] - nodes[p, 0], nodes[s, 1] - nodes[p, 1], nodes[s, 2] - nodes[p, 2]
    det = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    total = ax * ax + ay * ay + az * az + bx * bx + by * by + bz * bz + cx * cx + cy * cy + cz * cz
    total += (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2
    total += (bx - cx) ** 2 + (by - cy) ** 2 + (bz - cz) ** 2
    total += (cx - ax) ** 2 + (cy - ay) ** 2 + (cz - az) ** 2
    ratio = 12 * (0.5 * abs(det)) ** (2 / 3) / total
    return ratio if det > 0 else -ratio


@njit(**EXACT)
def _worst_around(
    nodes: FloatArray, tets: IntArray, start: IntArray, around: IntArray, v: int
) -> float:
    worst = 2.0
    for a in range(start[v], start[v + 1]):
        m = around[a]
        worst = min(worst, _mean_ratio(nodes, tets[m, 0], tets[m, 1], tets[m, 2], tets[m, 3]))
    return worst


@njit(**EXACT)
def _improve(
    nodes: FloatArray,
    tets: IntArray,
    start: IntArray,
    around: IntArray,
    skin: BoolArray,
    on_wall: BoolArray,
    level: float,
    cell_mm: float,
    passes: int,
    good: float,
    field: NDArray[np.float32],
    frame: FloatArray,
) -> None:
    """Try moves node by node: towards the neighbours' mean, then along the axes."""
    trial = np.empty(3)
    for sweep in range(passes):
        step = 0.12 * cell_mm * 0.6**sweep
        for v in range(len(nodes)):
            worst = _worst_around(nodes, tets, start, around, v)
            if worst >= good:
                continue
            old = nodes[v].copy()
            best = old.copy()
            mean = np.zeros(3)
            for a in range(start[v], start[v + 1]):
                m = around[a]
                for c in range(4):
                    mean += nodes[tets[m, c]]
            mean = (mean / (start[v + 1] - start[v]) - old) / 3
            for move in range(9):
                if move < 3:
                    for c in range(3):
                        trial[c] = old[c] + mean[c] / 2**move
                else:
                    # Axes are tried from the best place so far.
                    trial[:] = best
                    trial[(move - 3) // 2] += step if move % 2 else -step
                if on_wall[v]:
                    trial[2] = old[2]
                if skin[v] and not project(
                    field, frame, trial, level, on_wall[v], 0.3 * cell_mm, trial
                ):
                    continue
                nodes[v] = trial
                now = _worst_around(nodes, tets, start, around, v)
                if now > worst + 1e-4:
                    worst = now
                    best[:] = trial
            nodes[v] = best
