"""Interpolate the displacement of a mesh at material points."""

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, TetMesh
from palpate.workers.body.mesh.prolongation import prolongation

_NO_WALL = np.empty(0, np.int32)


def interpolation(mesh: TetMesh, points: FloatArray, farthest_mm: float = 5.0) -> csr_matrix:
    """Return the matrix from nodal values to values at points.

    Parameters
    ----------
    mesh : TetMesh
        Of n nodes.
    points : ndarray, shape (k, 3)
        (x, y, z) in mm, in the undeformed mesh or a little outside, where the nearest
        tetrahedron is continued; see `workers.body.mesh.prolongation`.
    farthest_mm : float
        How far a point may lie beyond where its tetrahedron can be continued.

    Returns
    -------
    csr_matrix, shape (k, n)
        Rows sum to 1. Linear fields are exact but where the continuation ends.

    Raises
    ------
    InputError
        If a point is farther outside than that, or not finite.
    """
    points = np.asarray(points, np.float64)
    if not np.isfinite(points).all():
        raise InputError("Points to be found in a mesh must be finite numbers, in mm.")
    matrix = prolongation(mesh, _NO_WALL, points, _NO_WALL)
    miss = np.linalg.norm(matrix @ mesh.nodes - points, axis=1)
    if miss.max(initial=0.0) > farthest_mm:
        raise InputError(
            f"{int(np.sum(miss > farthest_mm))} of {len(points)} points lie outside of the mesh, "
            f"one of them by {miss.max():.1f} mm; up to {farthest_mm:g} mm were expected. "
            "Check that mesh and points come from the same scan."
        )
    return matrix
