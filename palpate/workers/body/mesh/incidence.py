"""Elements around each node of a mesh."""

import numpy as np
from numba import njit

from palpate.storage.values import IntArray
from palpate.workers.compile_flags import EXACT


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
