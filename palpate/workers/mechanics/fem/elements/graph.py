"""Sparsity pattern of the tangent: pairs of nodes that share an element."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from palpate.storage.values import IntArray
from palpate.workers.compile_flags import CONTRACTED


@dataclass(frozen=True, eq=False)
class Graph:
    """Sparsity pattern of the tangent in compressed rows (CSR): nodes that share an element.

    Parameters
    ----------
    start : ndarray of int32, shape (n + 1,)
        Row i is ``neighbour[start[i]:start[i + 1]]``, ascending, i itself included.
    neighbour : ndarray of int32, shape (edges,)
    diagonal : ndarray of int32, shape (n,)
        Position of i in its own row.
    edge : ndarray of int32, shape (m, 4, 4)
        Row of ``neighbour`` for each ordered pair of nodes of each element.
    """

    start: IntArray
    neighbour: IntArray
    diagonal: IntArray
    edge: IntArray


def build_graph(n_nodes: int, tets: IntArray) -> Graph:
    """Build the graph of `tets`, shape (m, 4)."""
    start, neighbour = _rows(n_nodes, tets)
    edge = _edges(start, neighbour, tets)
    row = np.repeat(np.arange(n_nodes, dtype=np.int32), np.diff(start))
    diagonal = np.flatnonzero(row == neighbour).astype(np.int32)
    return Graph(start, neighbour, diagonal, edge)


@njit(**CONTRACTED)
def _rows(n_nodes: int, tets: IntArray) -> tuple[IntArray, IntArray]:
    """Return ``start`` and ``neighbour``; see `Graph`."""
    around = np.zeros(n_nodes + 1, np.int32)
    for e in range(tets.shape[0]):
        for a in range(4):
            around[tets[e, a] + 1] += 1
    for n in range(n_nodes):
        around[n + 1] += around[n]
    place = around[:-1].copy()
    elements = np.empty(around[n_nodes], np.int32)
    for e in range(tets.shape[0]):
        for a in range(4):
            n = tets[e, a]
            elements[place[n]] = e
            place[n] += 1
    start = np.zeros(n_nodes + 1, np.int32)
    visited = np.full(n_nodes, -1, np.int32)
    neighbour = np.empty(16 * n_nodes + 64, np.int32)
    filled = 0
    for n in range(n_nodes):
        first = filled
        for q in range(around[n], around[n + 1]):
            e = elements[q]
            for a in range(4):
                other = tets[e, a]
                if visited[other] != n:
                    visited[other] = n
                    if filled == neighbour.shape[0]:
                        grown = np.empty(2 * filled, np.int32)
                        grown[:filled] = neighbour
                        neighbour = grown
                    neighbour[filled] = other
                    filled += 1
        neighbour[first:filled].sort()
        start[n + 1] = filled
    return start, neighbour[:filled].copy()


@njit(**CONTRACTED)
def _edges(start: IntArray, neighbour: IntArray, tets: IntArray) -> IntArray:
    """Return the row of each ordered pair of nodes of each element, (m, 4, 4)."""
    edge = np.empty((tets.shape[0], 4, 4), np.int32)
    for e in range(tets.shape[0]):
        for a in range(4):
            n = tets[e, a]
            for b in range(4):
                row = neighbour[start[n] : start[n + 1]]
                edge[e, a, b] = start[n] + np.searchsorted(row, tets[e, b])
    return edge
