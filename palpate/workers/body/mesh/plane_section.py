"""Plane sections of a tetrahedral mesh: triangles and quadrangles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray, TetMesh

# Edges of a tetrahedron in the order of a quadrangle's corners, for tetrahedron corners (0, 1) on
# one side and (2, 3) on the other.
QUADRANGLE = ((0, 2), (0, 3), (1, 3), (1, 2))
# Nodes closer to the plane than this, relative to the mesh, are moved off it.
BESIDE = 1e-9


@dataclass(frozen=True, eq=False)
class PlaneSection:
    """Polygons in which a plane intersects the tetrahedra of a mesh.

    Parameters
    ----------
    polygons : ndarray, shape (m, 4, 2)
        Corners in mm, along the two other axes in the order of (x, y, z); a triangle repeats its
        last corner.
    tets : ndarray of int, shape (m,)
        The tetrahedron of each polygon.
    """

    polygons: FloatArray
    tets: NDArray[np.int64]


def plane_section(mesh: TetMesh, normal: int, at_mm: float) -> PlaneSection:
    """Cut a mesh with a plane normal to one axis.

    Parameters
    ----------
    mesh : TetMesh
    normal : {0, 1, 2}
        The axis normal to the plane.
    at_mm : float
        Coordinate of the plane along that axis.

    Returns
    -------
    PlaneSection
        Empty if the plane misses the mesh.
    """
    height = mesh.nodes[:, normal] - at_mm
    near = BESIDE * float(np.ptp(mesh.nodes[:, normal]))
    height = np.where(np.abs(height) < near, near, height)
    above = height[mesh.tets] > 0
    count = above.sum(axis=1)
    flat = np.delete(mesh.nodes, normal, axis=1)
    found, owners = [], []
    for wanted in (1, 2, 3):
        tets = np.flatnonzero(count == wanted)
        # The corners of the smaller side first; if both have two, those above.
        sides = above[tets] if wanted < 3 else ~above[tets]
        order = np.argsort(~sides, axis=1, kind="stable")
        corners = np.take_along_axis(mesh.tets[tets], order, axis=1)
        edges = QUADRANGLE if wanted == 2 else ((0, 1), (0, 2), (0, 3), (0, 3))
        found.append(np.stack([_crossing(corners, e, height, flat) for e in edges], axis=1))
        owners.append(tets)
    return PlaneSection(np.concatenate(found), np.concatenate(owners))


def _crossing(
    corners: IntArray, edge: tuple[int, int], height: FloatArray, flat: FloatArray
) -> FloatArray:
    """Return the intersection of the plane with an edge of each tetrahedron, shape (m, 2)."""
    i, j = corners[:, edge[0]], corners[:, edge[1]]
    share = (height[i] / (height[i] - height[j]))[:, None]
    return np.asarray(flat[i] + share * (flat[j] - flat[i]))
