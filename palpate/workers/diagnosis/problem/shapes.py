"""Interfaces of a body as a few thousand triangles, for display on a page.

Vertices of the fine surface that share a cell of a cubic lattice are merged at their mean;
triangles that lose a corner vanish (J. Rossignac and P. Borrel, Multi-resolution 3D approximations
for rendering complex scenes, 1993).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, Tissue, Volume
from palpate.workers.comparison.observation.interface import Interface
from palpate.workers.comparison.observation.isosurface import surface

EDGE_MM = 3.0


class Shape(NamedTuple):
    """A triangulated interface.

    Parameters
    ----------
    vertices : ndarray, shape (n, 3)
        (x, y, z) in mm.
    triangles : ndarray of int32, shape (m, 3)
        Counter-clockwise seen from outside the tissue.
    """

    vertices: FloatArray
    triangles: IntArray


def shapes(labels: Volume, interfaces: Sequence[Interface]) -> dict[str, NDArray[Any]]:
    """Return ``shape_<interface>_vertices`` and ``_triangles`` for each interface."""
    arrays: dict[str, NDArray[Any]] = {}
    for interface in interfaces:
        drawn = shape(labels, interface.inside)
        arrays[f"shape_{interface.name}_vertices"] = drawn.vertices.astype(np.float32)
        arrays[f"shape_{interface.name}_triangles"] = drawn.triangles
    return arrays


def shape(labels: Volume, inside: tuple[Tissue, ...], edge_mm: float = EDGE_MM) -> Shape:
    """Triangulate an interface coarsely.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels.
    inside : tuple of Tissue
        The tissues inside the interface.
    edge_mm : float
        Approximate edge length; > 0. Thinner layers collapse to a single sheet.

    Raises
    ------
    InputError
        If the tissue is missing or fills the volume, or no triangles remain.
    """
    if not edge_mm > 0:
        raise InputError(f"The edge length of triangles must be > 0 mm, found {edge_mm}.")
    fine = surface(labels, inside)
    cells = np.floor(fine.vertices / edge_mm).astype(np.int64)
    _, cluster = np.unique(cells, axis=0, return_inverse=True)
    cluster = cluster.reshape(-1)
    vertices = _means(cluster, fine.vertices)
    outwards = _means(cluster, fine.normals())
    corners = cluster[fine.triangles]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(corners, axis=1), axis=0, return_index=True)
    triangles = corners[np.sort(first)]
    if not len(triangles):
        raise InputError(
            f"An interface smaller than {edge_mm:g} mm has no triangles of that size. "
            "Use a shorter edge."
        )
    return Shape(vertices, _turned(vertices, triangles, outwards))


def _means(cluster: NDArray[np.integer], values: FloatArray) -> FloatArray:
    sums = [np.bincount(cluster, column) for column in values.T]
    return np.asarray(np.stack(sums, axis=1) / np.bincount(cluster)[:, None])


def _turned(vertices: FloatArray, triangles: NDArray[np.integer], outwards: FloatArray) -> IntArray:
    """Return triangles with their corners ordered so that their normals point outwards."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    inward = (np.cross(b - a, c - a) * outwards[triangles].sum(axis=1)).sum(axis=1) < 0
    turned = triangles.astype(np.int32)
    turned[inward] = turned[inward][:, ::-1]
    return turned
