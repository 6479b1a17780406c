"""Gradients of the stiffness of a cornea through its depth and from side to side."""

import numpy as np

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.organs.cornea.material.model import CorneaModel
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh


def stiffness_factors(mesh: T6Mesh, model: CorneaModel) -> FloatArray:
    """Return the factor of the moduli of each triangle, shape (m,).

    The factor is ``exp(depth_gradient d + side_gradient s)``, with d from the anterior (-1/2)
    to the posterior surface (1/2), s from the left (-1/2) to the right edge (1/2).
    """
    if model.depth_gradient == 0 and model.side_gradient == 0:
        return np.ones(len(mesh.triangles))
    centres = mesh.nodes_mm[mesh.triangles[:, :3]].mean(axis=1)
    above = _distance(centres, mesh.nodes_mm, mesh.anterior)
    below = _distance(centres, mesh.nodes_mm, mesh.posterior)
    depth = above / (above + below) - 0.5
    x = mesh.nodes_mm[:, 0]
    side = (centres[:, 0] - x.min()) / (x.max() - x.min()) - 0.5
    return np.exp(model.depth_gradient * depth + model.side_gradient * side)


def _distance(points: FloatArray, nodes_mm: FloatArray, surface: IntArray) -> FloatArray:
    """Return the distances of points from a polyline of nodes."""
    start, end = nodes_mm[surface[:-1]], nodes_mm[surface[1:]]
    along = end - start
    arm = points[:, None] - start
    fraction = np.clip((arm * along).sum(-1) / (along**2).sum(-1), 0, 1)
    return np.linalg.norm(arm - fraction[..., None] * along, axis=-1).min(axis=1)
