"""Quality of the 6-node triangles of a section."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh


@dataclass(frozen=True)
class T6Quality:
    r"""Quality of a mesh of 6-node triangles.

    Parameters
    ----------
    smallest_shape, mean_shape : float
        Mean ratio of the corner triangles, :math:`4 \sqrt 3 A / (a^2 + b^2 + c^2)`: 1 for
        equal sides, 0 for a triangle without area.
    smallest_jacobian : float
        Lower bound of the Jacobian determinant in any element, over twice the area of its
        corner triangle: 1 for straight sides, > 0 if the map is one-to-one.
    """

    smallest_shape: float
    mean_shape: float
    smallest_jacobian: float


def t6_quality(mesh: T6Mesh) -> T6Quality:
    """Return the quality of a mesh.

    The Jacobian determinant of a 6-node triangle is a polynomial of degree two. The smallest
    of its six Bernstein coefficients bounds it from below, so a positive value proves that no
    element is folded (A. Johnen, J.-F. Remacle, C. Geuzaine, J. Comput. Phys. 233, 2013).
    """
    corners = mesh.nodes_mm[mesh.triangles[:, :3]]
    sides = np.roll(corners, -1, axis=1) - corners
    area = 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    shape = 4 * np.sqrt(3) * area / np.sum(sides**2, axis=(1, 2))
    relative = _jacobian_coefficients(mesh).min(axis=1) / (2 * np.abs(area))
    return T6Quality(
        smallest_shape=float(shape.min()),
        mean_shape=float(shape.mean()),
        smallest_jacobian=float(relative.min()),
    )


def _jacobian_coefficients(mesh: T6Mesh) -> FloatArray:
    """Return the Bernstein coefficients of the Jacobian determinants, shape (m, 6)."""
    xi = np.array([0.0, 1.0, 0.0, 0.5, 0.5, 0.0])
    eta = np.array([0.0, 0.0, 1.0, 0.0, 0.5, 0.5])
    rest = 1 - xi - eta
    zero = np.zeros(6)
    along_xi = np.stack(
        [1 - 4 * rest, 4 * xi - 1, zero, 4 * (rest - xi), 4 * eta, -4 * eta], axis=1
    )
    along_eta = np.stack(
        [1 - 4 * rest, zero, 4 * eta - 1, -4 * xi, 4 * xi, 4 * (rest - eta)], axis=1
    )
    nodes = mesh.nodes_mm[mesh.triangles]
    a = np.einsum("qn,eni->eqi", along_xi, nodes)
    b = np.einsum("qn,eni->eqi", along_eta, nodes)
    values = a[:, :, 0] * b[:, :, 1] - a[:, :, 1] * b[:, :, 0]
    corner, middle = values[:, :3], values[:, 3:]
    edges = 2 * middle - 0.5 * (corner + np.roll(corner, -1, axis=1))
    return np.concatenate([corner, edges], axis=1)
