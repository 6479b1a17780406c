"""Parts of an inverse problem, as named arrays, which any process can prepare in advance.

::

    points    points on the interfaces of the scan at rest
    body      the volume to be meshed
    scan N    distances to the interfaces of a loaded scan, and their areas
    shapes    interfaces of the scan at rest, as shown on a page

The shapes are interfaces as a few thousand triangles. Vertices of the fine surface that share a
cell of a cubic lattice are merged at their mean; triangles that lose a corner vanish (J. Rossignac
and P. Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, Tissue, Volume
from palpate.workers.comparison.observation.interface_residual import (
    Interface,
    InterfacePoints,
    Observed,
    SignedDistance,
)
from palpate.workers.comparison.observation.isosurface import surface

SHAPE_EDGE_MM = 3.0


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


def shape(labels: Volume, inside: tuple[Tissue, ...], edge_mm: float = SHAPE_EDGE_MM) -> Shape:
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


Prepared = dict[str, NDArray[Any]]
ReadPrepared = Callable[[str], Prepared]
"""Returns the arrays of a named preparation."""

POINTS, BODY, SHAPES = "points", "body", "shapes"
_PLACE, _AREAS = "place", "interface_mm2"


def scan_preparation(number: int) -> str:
    """Return the name of the preparation with the distances of one loaded scan."""
    return f"scan {number}"


def preparations_of(scans: int) -> tuple[str, ...]:
    """Return the names of all preparations for `scans` loaded scans, the slowest first."""
    return (POINTS, *map(scan_preparation, range(scans)), BODY, SHAPES)


def arrays_of_volume(volume: Volume) -> Prepared:
    """Return a volume as arrays."""
    return {"values": volume.values, _PLACE: _place(volume)}


def volume_of(arrays: Prepared) -> Volume:
    """Return the volume from the arrays of `arrays_of_volume`."""
    return Volume(arrays["values"], *_spacing_and_origin(arrays))


def arrays_of_points(points: InterfacePoints) -> Prepared:
    """Return interface points as arrays."""
    return {
        "points": points.points,
        "normals": points.normals,
        "interface": points.interface,
        "area_mm2": points.area_mm2,
        "part": points.part,
    }


def points_of(arrays: Prepared) -> InterfacePoints:
    """Return the points from the arrays of `arrays_of_points`."""
    return InterfacePoints(**arrays)


def arrays_of_distances(observed: Observed) -> Prepared:
    """Return the distances to all interfaces of a scan as arrays."""
    values = {f"distance_{n}": one.values for n, one in enumerate(observed.distances)}
    areas = np.array([one.interface_mm2 for one in observed.distances])
    return {**values, _AREAS: areas, _PLACE: _place(observed.distances[0])}


def distances_of(arrays: Prepared) -> Observed:
    """Return the distances from the arrays of `arrays_of_distances`."""
    spacing, origin = _spacing_and_origin(arrays)
    return Observed(
        tuple(
            SignedDistance(arrays[f"distance_{n}"], spacing, origin, float(area))
            for n, area in enumerate(arrays[_AREAS])
        )
    )


def _place(lattice: Volume | SignedDistance) -> NDArray[np.float64]:
    return np.array([lattice.spacing_mm, lattice.origin_mm])


def _spacing_and_origin(arrays: Prepared) -> Sequence[Any]:
    return [tuple(map(float, row)) for row in arrays[_PLACE]]
