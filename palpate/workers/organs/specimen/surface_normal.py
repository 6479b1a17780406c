"""Outward normals at points of a surface."""

from collections.abc import Sequence

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.organs.specimen.readings.spec import FinitePoint

# Faces as close as the nearest one, within this fraction of an element, touch the point.
TOUCH = 1e-3
# Normals more than 25 degrees from their mean are ambiguous.
ALIKE = 0.9


def outward_normals(
    nodes: FloatArray,
    triangles: IntArray,
    points: FloatArray,
    stated: Sequence[FinitePoint | None],
    names: Sequence[str],
) -> FloatArray:
    """Return unit normals at points of a surface, shape (k, 3).

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
    triangles : ndarray of int, shape (m, 3)
        Corners of the triangles, oriented outwards.
    points : ndarray, shape (k, 3)
    stated : sequence
        A direction for each point; None for the normal of the surface.
    names : sequence of str
        Names of the points, for the message.

    Raises
    ------
    InputError
        If a point on an edge, where the surface has no normal, has no given direction.
    """
    corners = nodes[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(size, 1e-300)[:, None]
    near = TOUCH * float(np.sqrt(size.mean()))
    found = []
    for point, direction, name in zip(points, stated, names, strict=True):
        if direction is not None:
            found.append(np.asarray(direction) / np.linalg.norm(direction))
            continue
        away = distances_to_triangles(point, corners)
        there = normal[away <= away.min() + near]
        mean = there.sum(axis=0)
        mean = mean / max(float(np.linalg.norm(mean)), 1e-300)
        if (there @ mean).min() < ALIKE:
            raise InputError(
                f"The marker {name} is on an edge of the body, where the outward direction is "
                "ambiguous. Give its direction: outward: [x, y, z]."
            )
        found.append(mean)
    return np.array(found)


def distances_to_triangles(point: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the distances in mm of a point from triangles, corners of shape (m, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    to_plane = _to_inside(point, a, b, c)
    to_edges = [_to_segment(point, *ends) for ends in ((a, b), (b, c), (c, a))]
    return np.minimum(to_plane, np.min(to_edges, axis=0))


def _to_inside(point: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return the distance from the plane if the foot is inside the triangle, else infinity."""
    n = np.cross(b - a, c - a)
    square = np.maximum((n**2).sum(axis=1), 1e-300)
    u = (np.cross(point - a, c - a) * n).sum(axis=1) / square
    v = (np.cross(b - a, point - a) * n).sum(axis=1) / square
    height = np.abs(((point - a) * n).sum(axis=1)) / np.sqrt(square)
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1), height, np.inf)


def _to_segment(point: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    along = b - a
    length = np.maximum((along**2).sum(axis=1), 1e-300)
    t = np.clip(((point - a) * along).sum(axis=1) / length, 0, 1)
    return np.asarray(np.linalg.norm(point - a - t[:, None] * along, axis=1))
