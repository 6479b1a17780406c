"""Shape functions of triangles with six nodes.

A triangle has its corners 0, 1 and 2 counterclockwise, then the middles of edges 01, 12 and 20.
"""

import numpy as np

from palpate.storage.values import FloatArray

# Corners at the ends of the edges, in the order of their midside nodes 3, 4 and 5.
TRIANGLE_EDGES = ((0, 1), (1, 2), (2, 0))


def shapes(barycentric: FloatArray) -> FloatArray:
    """Return the six shape functions at points, (k, 3) to (k, 6)."""
    corners = barycentric * (2 * barycentric - 1)
    middles = [4 * barycentric[:, a] * barycentric[:, b] for a, b in TRIANGLE_EDGES]
    return np.column_stack([corners, *middles])


def shape_slopes(barycentric: FloatArray) -> FloatArray:
    """Return derivatives of the shape functions in the barycentric coordinates, (k, 6, 3)."""
    slopes = np.zeros((len(barycentric), 6, 3))
    for k in range(3):
        slopes[:, k, k] = 4 * barycentric[:, k] - 1
    for k, (a, b) in enumerate(TRIANGLE_EDGES):
        slopes[:, 3 + k, a], slopes[:, 3 + k, b] = 4 * barycentric[:, b], 4 * barycentric[:, a]
    return slopes


def shape_functions(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the shape functions, (q, 6), and their slopes, (q, 6, 2), at points (q, 2).

    The coordinates of a point are the weights of corners 1 and 2.
    """
    barycentric = np.column_stack([1 - points[:, 0] - points[:, 1], points])
    slopes = shape_slopes(barycentric)
    return shapes(barycentric), slopes[:, :, 1:] - slopes[:, :, :1]
