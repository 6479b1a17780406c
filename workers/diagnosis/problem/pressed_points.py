"""Points of the outline that a plate presses: they lie on the plate, whatever was drawn.

The points of a diagnosis lie on the drawn outline, its mesh cuts the corners of a smoothed one: a
point is some tenths of a millimetre above a face or below. What is free carries that along; what a
plate presses becomes flat, bumps and all. Such a point is followed at its foot on the mesh, and the
error with which it was drawn at rest is not in its residual. (Followed with its bump, points of
three controls stood out of the plate by 0.1 to 0.5 mm, all the same way, since flat faces lie
inside of a round body.)

Labels at rest that have no such error are those that a mesh of ours has moved, bumps and all:
their points are followed as before.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags_array
from scipy.spatial import KDTree

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.problem.inverse_problem import FollowedPoints, InverseProblem
from palpate.workers.mechanics.fem.elements.model import LevelModel

# Faces about a point among which its foot is looked for.
NEAREST = 16


def with_pressed_points(inverse: InverseProblem, pressed: Sequence[FloatArray]) -> InverseProblem:
    """Return the problem whose points are followed on the surface where plates press.

    Parameters
    ----------
    inverse : InverseProblem
    pressed : sequence of ndarray, shape (k,)
        For each scan, how far each point is pressed, 0 to 1; see `pressed_shares`. If none is
        in any scan, the problem stays as it is.
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
    """Return how far each point is pressed, shape (k,): 1 in a face whose corners all are.

    Parameters
    ----------
    inverse : InverseProblem
    pressed : ndarray of bool, shape (n,)
        Nodes that a plate presses.
    """
    share = _feet(inverse.model.finest, inverse.points.points) @ pressed.astype(np.float64)
    return np.where(inverse.points.interface == 0, share, 0.0)


def _feet(level: LevelModel, points: FloatArray) -> csr_matrix:
    """Return the matrix from values at nodes to those at the feet of points on the free surface.

    The foot is dropped on the plane of a face and, if it misses the face, moved to its rim.
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
    """Return weights of corners (k, f, 3, 3) at points (k, 1, 3): none below zero, their sum 1."""
    a, b = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
    p = points - corners[:, :, 0]
    aa, ab, bb = ((x * y).sum(axis=2) for x, y in ((a, a), (a, b), (b, b)))
    pa, pb = (p * a).sum(axis=2), (p * b).sum(axis=2)
    area = np.maximum(aa * bb - ab**2, 1e-12)
    second, third = (bb * pa - ab * pb) / area, (aa * pb - ab * pa) / area
    found = np.maximum(np.stack([1.0 - second - third, second, third], axis=2), 0.0)
    return np.asarray(found / found.sum(axis=2, keepdims=True))
