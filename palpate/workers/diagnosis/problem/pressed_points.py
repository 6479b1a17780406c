"""Points of the outline pressed by a plate, which are on the plate wherever they were drawn.

The points of a diagnosis are on the drawn outline, while the mesh faces cut the corners of a
smoothed outline, so a point is a few tenths of a millimetre above or below a face. On the free
surface, this offset moves with the body; under a plate, the surface becomes flat. A pressed point
is therefore followed at its foot on the mesh, and its residual excludes the segmentation error at
rest. (Followed with their offsets, points of three controls were outside the plate by 0.1 to 0.5
mm, all in the same direction, since flat faces are inside a round body.)

Labels at rest without such an error come from one of our own meshes, which moves the offsets too;
their points are followed as on the free surface.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags_array
from scipy.spatial import KDTree

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.problem.inverse_problem import FollowedPoints, InverseProblem
from palpate.workers.mechanics.fem.elements.model import LevelModel

# Number of faces near a point that are searched for its foot.
NEAREST = 16


def with_pressed_points(inverse: InverseProblem, pressed: Sequence[FloatArray]) -> InverseProblem:
    """Return the problem with pressed points followed on the mesh surface.

    Parameters
    ----------
    inverse : InverseProblem
    pressed : sequence of ndarray, shape (k,)
        Pressed share of each point, 0 to 1, in each scan; see `pressed_shares`. If no point is
        pressed in any scan, the problem is returned unchanged.
    """
    if not any(share.any() for share in pressed):
        return inverse
    feet = _feet(inverse.model.finest, inverse.points.points)
    on_surface = feet @ inverse.model.finest.nodes
    scans = []
    for scan, share in zip(inverse.scans, pressed, strict=True):
        free = diags_array(1.0 - share)
        points = free @ inverse.points.points + share[:, None] * on_surface
        at_points = csr_matrix(free @ inverse.at_points + diags_array(share) @ feet)
        scans.append(replace(scan, followed=FollowedPoints(points, at_points, share)))
    return replace(inverse, scans=scans)


def pressed_shares(inverse: InverseProblem, pressed: BoolArray) -> FloatArray:
    """Return the pressed share of each point, shape (k,): 1 in a face with all corners pressed.

    Parameters
    ----------
    inverse : InverseProblem
    pressed : ndarray of bool, shape (n,)
        Nodes that a plate presses.
    """
    share = _feet(inverse.model.finest, inverse.points.points) @ pressed.astype(np.float64)
    return np.where(inverse.points.interface == 0, share, 0.0)


def _feet(level: LevelModel, points: FloatArray) -> csr_matrix:
    """Return the interpolation matrix from the nodes to the feet of points on the free surface.

    The foot is the projection on the plane of a face, moved to its rim if it misses the face.
    """
    faces = level.contact_nodes.index[level.contact_nodes.faces.corners]
    corners = level.nodes[faces]
    near = np.asarray(KDTree(corners.mean(axis=1)).query(points, k=NEAREST)[1])
    weights = _barycentric(points[:, None], corners[near])
    feet = np.einsum("kfc,kfcx->kfx", weights, corners[near])
    best = np.linalg.norm(feet - points[:, None], axis=2).argmin(axis=1)
    rows = np.arange(len(points))
    columns: IntArray = faces[near[rows, best]]
    shape = (len(points), len(level.nodes))
    return csr_matrix((weights[rows, best].ravel(), (np.repeat(rows, 3), columns.ravel())), shape)


def _barycentric(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return nonnegative weights of the corners (k, f, 3, 3), with sum 1, at points (k, 1, 3)."""
    a, b = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
    p = points - corners[:, :, 0]
    aa, ab, bb = ((x * y).sum(axis=2) for x, y in ((a, a), (a, b), (b, b)))
    pa, pb = (p * a).sum(axis=2), (p * b).sum(axis=2)
    area = np.maximum(aa * bb - ab**2, 1e-12)
    second, third = (bb * pa - ab * pb) / area, (aa * pb - ab * pa) / area
    found = np.maximum(np.stack([1.0 - second - third, second, third], axis=2), 0.0)
    return np.asarray(found / found.sum(axis=2, keepdims=True))
