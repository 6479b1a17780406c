"""Cuts a tetrahedral mesh by a plane: the triangles and quadrangles that a slice shows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray, TetMesh

# The six edges of a tetrahedron, and the order in which those of a quadrangle follow each
# other where corners (0, 1) lie on one side and (2, 3) on the other.
QUADRANGLE = ((0, 2), (0, 3), (1, 3), (1, 2))
# A node this near to the plane, over the extent of the mesh, is put beside it.
BESIDE = 1e-9


@dataclass(frozen=True, eq=False)
class PlaneSection:
    """Polygons in which a plane meets the tetrahedra of a mesh.

    Parameters
    ----------
    polygons : ndarray, shape (m, 4, 2)
        Corners in mm, along the two other axes in the order of (x, y, z); a triangle has its
        last corner twice.
    tets : ndarray of int, shape (m,)
        The tetrahedron of each polygon.
    """

    polygons: FloatArray
    tets: NDArray[np.int64]


def plane_section(mesh: TetMesh, normal: int, at_mm: float) -> PlaneSection:
    """Cut a mesh at a coordinate.

    Parameters
    ----------
    mesh : TetMesh
    normal : {0, 1, 2}
        The axis that is normal to the plane.
    at_mm : float
        Where the plane meets that axis.

    Returns
    -------
    PlaneSection
        Empty where the plane misses the mesh.
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
        # The corners of the smaller side first; of two and two those above.
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
    """Return where the plane meets an edge of each tetrahedron, shape (m, 2)."""
    i, j = corners[:, edge[0]], corners[:, edge[1]]
    share = (height[i] / (height[i] - height[j]))[:, None]
    return np.asarray(flat[i] + share * (flat[j] - flat[i]))
