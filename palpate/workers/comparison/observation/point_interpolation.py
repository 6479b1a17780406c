"""Interpolation of mesh displacements at material points."""

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, TetMesh
from palpate.workers.body.mesh.prolongation import prolongation

_NO_WALL = np.empty(0, np.int32)


def interpolation(mesh: TetMesh, points: FloatArray, farthest_mm: float = 5.0) -> csr_matrix:
    """Return the interpolation matrix from nodal values to values at points.

    Parameters
    ----------
    mesh : TetMesh
        Mesh with n nodes.
    points : ndarray, shape (k, 3)
        (x, y, z) in mm, in the undeformed mesh or a little outside, where the nearest
        tetrahedron is extrapolated; see `workers.body.mesh.prolongation`.
    farthest_mm : float
        Largest distance of a point outside the range of that extrapolation.

    Returns
    -------
    csr_matrix, shape (k, n)
        Rows sum to 1. Linear fields are exact within the range of the extrapolation.

    Raises
    ------
    InputError
        If a point is farther outside, or its coordinates are not finite.
    """
    points = np.asarray(points, np.float64)
    if not np.isfinite(points).all():
        raise InputError("The coordinates of points in a mesh must be finite numbers, in mm.")
    matrix = prolongation(mesh, _NO_WALL, points, _NO_WALL)
    miss = np.linalg.norm(matrix @ mesh.nodes - points, axis=1)
    if miss.max(initial=0.0) > farthest_mm:
        raise InputError(
            f"{int(np.sum(miss > farthest_mm))} of {len(points)} points are more than "
            f"{farthest_mm:g} mm outside the mesh, the farthest by {miss.max():.1f} mm. "
            "Check that mesh and points come from the same scan."
        )
    return matrix
