"""Shape functions, quadrature and undeformed gradients of 6-node triangles."""

from typing import NamedTuple

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.elements.simd import LANES
from palpate.workers.organs.cornea.mesh.quadrature import QUADRATURE
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh


class PointGeometry(NamedTuple):
    """Undeformed triangles at their quadrature points.

    Parameters
    ----------
    gradients : ndarray, shape (m, q, 2, 8)
        Derivatives of the six shape functions in x and y, in 1/mm; padded with zeros for SIMD.
    hoop : ndarray, shape (m, q, 8)
        Shape function over radius in 1/mm; zero in a plane.
    weights : ndarray, shape (m, q)
        Area in mm², or volume per radian in mm³.
    """

    gradients: FloatArray
    hoop: FloatArray
    weights: FloatArray


def shape_functions(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the shape functions, (q, 6), and their slopes, (q, 6, 2), at points (q, 2)."""
    x, y = points[:, 0], points[:, 1]
    z = 1 - x - y
    zero = np.zeros_like(x)
    N = np.stack(
        [z * (2 * z - 1), x * (2 * x - 1), y * (2 * y - 1), 4 * z * x, 4 * x * y, 4 * y * z], 1
    )
    along_x = np.stack([1 - 4 * z, 4 * x - 1, zero, 4 * (z - x), 4 * y, -4 * y], 1)
    along_y = np.stack([1 - 4 * z, zero, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)], 1)
    return N, np.stack([along_x, along_y], 2)


def point_geometry(
    mesh: T6Mesh, nodes_mm: FloatArray, n_points: int, axisymmetric: bool
) -> PointGeometry:
    """Return the geometry of a mesh with nodes at `nodes_mm`.

    Raises
    ------
    InputError
        If a triangle is inverted.
    """
    points, weights = QUADRATURE[n_points]
    N, slopes = shape_functions(points)
    corners = nodes_mm[mesh.triangles]
    # jacobian[e, q, i, j] = d x_i / d xi_j
    jacobian = np.matmul(corners.transpose(0, 2, 1)[:, None], slopes[None])
    a, b = jacobian[..., 0, 0], jacobian[..., 0, 1]
    c, d = jacobian[..., 1, 0], jacobian[..., 1, 1]
    area = a * d - b * c
    if not (area > 0).all():
        bad = int(np.argmin(area.min(axis=1)))
        raise InputError(
            f"Triangle {bad} of the corneal mesh is inverted or badly distorted. Nodes run "
            "counter-clockwise, corners first; check that the two surfaces do not cross."
        )
    by_x = d[..., None] * slopes[..., 0] - c[..., None] * slopes[..., 1]
    by_y = a[..., None] * slopes[..., 1] - b[..., None] * slopes[..., 0]
    gradients = np.zeros((*area.shape, 2, LANES))
    gradients[..., :6] = np.stack([by_x, by_y], axis=-2) / area[..., None, None]
    hoop = np.zeros((*area.shape, LANES))
    weights = area * weights
    if axisymmetric:
        radius = corners[:, :, 0] @ N.T
        hoop[..., :6] = N / radius[..., None]
        weights = weights * np.abs(radius)
    return PointGeometry(gradients, hoop, weights)
