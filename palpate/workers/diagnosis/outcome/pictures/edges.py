"""Sharp edges of a body at rest and deformed, which outline its shape."""

from collections.abc import Mapping, Sequence

import numpy as np

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.diagnosis.outcome.pictures.drawings import Arrays

SHARP_DEGREES = 40.0


def edge_arrays(
    nodes: FloatArray, edges: IntArray, displacements: Mapping[str, Sequence[FloatArray]]
) -> Arrays:
    """Return the edges of a body at rest and deformed, for pictures.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
        Positions at rest, in mm.
    edges : ndarray, shape (e, 2)
        See `sharp_edges`.
    displacements : mapping of str to sequence of ndarray, shape (n, 3)
        Displacements in every state, "before" and "after"; those on another mesh are ignored.

    Returns
    -------
    dict of str to ndarray
        ``edges_rest`` (e, 2, 3), ``edges_before`` and ``edges_after`` (states, e, 2, 3), in mm.
    """
    found: Arrays = {"edges_rest": nodes[edges]}
    for when, states in displacements.items():
        if all(np.shape(u) == nodes.shape for u in states):
            found[f"edges_{when}"] = np.stack([(nodes + u)[edges] for u in states])
    return found


def sharp_edges(nodes: FloatArray, triangles: IntArray, degrees: float = SHARP_DEGREES) -> IntArray:
    """Return the edges where a closed surface bends by more than an angle, shape (e, 2).

    Examples
    --------
    >>> from palpate.workers.body.mesh.boundary import boundary_triangles
    >>> nodes = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    >>> faces = boundary_triangles(np.array([[0, 1, 2, 3]], np.int32))
    >>> len(sharp_edges(nodes, faces))
    6
    """
    a, b, c = (nodes[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    pairs = np.sort(triangles[:, ((0, 1), (1, 2), (2, 0))].reshape(-1, 2), axis=1)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    # In a closed surface, every edge occurs twice, once for each adjacent triangle.
    first, second = order[::2], order[1::2]
    bend = (normals[first // 3] * normals[second // 3]).sum(axis=1)
    return np.asarray(pairs[first[bend < np.cos(np.radians(degrees))]])
