"""Material points on the true interfaces of a body."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from palpate.storage.values import FloatArray, IntArray, Tissue, Volume
from palpate.workers.blind.solver.quadratic_element import (
    EDGES,
    FACE_EDGES,
    QuadraticMesh,
    face_areas,
)

OUTLINE, GLANDULAR = 0, 1
WALL_MARGIN_MM = 4.0
NEAREST = 40  # elements tried for each point


@dataclass(frozen=True, eq=False)
class MaterialPoints:
    """Set of k points that move with the tissue.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Positions in the undeformed body, in mm.
    interface : ndarray of int32, shape (k,)
        `OUTLINE` or `GLANDULAR`.
    nodes : ndarray of int32, shape (k, 10)
    weights : ndarray, shape (k, 10)
        Weights of the nodes; a point's displacement is the weighted sum over its nodes.
    """

    points: FloatArray
    interface: IntArray
    nodes: IntArray
    weights: FloatArray

    def moved(self, displacement_mm: FloatArray) -> FloatArray:
        """Return the displacements (k, 3) of the points, given nodal displacements (n, 3)."""
        return np.asarray(np.einsum("ka,kai->ki", self.weights, displacement_mm[self.nodes]))


def points_on(mesh: QuadraticMesh, labels: Volume, count: int, seed: int) -> MaterialPoints:
    """Spread points over the outline and over the boundary of the glandular tissue.

    Parameters
    ----------
    mesh : QuadraticMesh
    labels : Volume
        `Tissue` labels of the undeformed body.
    count : int
        Number of points on each of the two; points outside all elements, or within 4 mm of the
        chest wall, are then dropped.
    seed : int
    """
    rng = np.random.default_rng(seed)
    outline = _on_outline(mesh, count, rng)
    gland = _on_gland(mesh, labels, count, rng)
    parts = [p for p in (outline, gland) if len(p.points)]
    return MaterialPoints(
        *(
            np.concatenate([getattr(p, name) for p in parts])
            for name in ("points", "interface", "nodes", "weights")
        )
    )


def _on_outline(mesh: QuadraticMesh, count: int, rng: np.random.Generator) -> MaterialPoints:
    areas = face_areas(mesh, mesh.skin)
    faces = mesh.skin[rng.choice(len(areas), 2 * count, p=areas / areas.sum())]
    L = rng.dirichlet((1.0, 1.0, 1.0), 2 * count)
    points = np.einsum("ka,kai->ki", L, mesh.nodes[faces[:, :3]])
    kept = np.flatnonzero(points[:, 2] > WALL_MARGIN_MM)[:count]
    faces, L = faces[kept], L[kept]
    middle = 4 * L[:, FACE_EDGES[:, 0]] * L[:, FACE_EDGES[:, 1]]
    weights = np.hstack([L * (2 * L - 1), middle, np.zeros((len(kept), 4))])
    nodes = np.hstack([faces, np.repeat(faces[:, :1], 4, axis=1)])
    return MaterialPoints(points[kept], np.full(len(kept), OUTLINE, np.int32), nodes, weights)


def _on_gland(
    mesh: QuadraticMesh, labels: Volume, count: int, rng: np.random.Generator
) -> MaterialPoints:
    share = ndimage.gaussian_filter((labels.values == Tissue.GLANDULAR).astype(np.float32), 0.8)
    vertices, triangles, _, _ = marching_cubes(share, 0.5)
    corners = vertices[:, ::-1][triangles] * labels.spacing_mm + labels.origin_mm
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(sides, axis=1)
    drawn = corners[rng.choice(len(areas), 2 * count, p=areas / areas.sum())]
    points = np.einsum("ka,kai->ki", rng.dirichlet((1.0, 1.0, 1.0), 2 * count), drawn)
    points = points[points[:, 2] > WALL_MARGIN_MM]
    cells, L = locate(mesh, points)
    kept = np.flatnonzero(cells >= 0)[:count]
    L = L[kept]
    weights = np.hstack([L * (2 * L - 1), 4 * L[:, EDGES[:, 0]] * L[:, EDGES[:, 1]]])
    which = np.full(len(kept), GLANDULAR, np.int32)
    return MaterialPoints(points[kept], which, mesh.cells[cells[kept]], weights)


def locate(mesh: QuadraticMesh, points: FloatArray) -> tuple[IntArray, FloatArray]:
    """Find the element of each point (k, 3), -1 outside, and barycentric coordinates (k, 4)."""
    corners = mesh.nodes[mesh.cells[:, :4]]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    inverse = np.linalg.inv(edges)
    tries = list(range(1, min(NEAREST, len(corners)) + 1))
    near = np.asarray(KDTree(corners.mean(axis=1)).query(points, k=tries)[1])
    away = points[:, None] - corners[near, 0]
    last = np.einsum("kcij,kcj->kci", inverse[near], away)
    L = np.concatenate([1 - last.sum(axis=2, keepdims=True), last], axis=2)
    best = L.min(axis=2).argmax(axis=1)
    row = np.arange(len(points))
    L, cells = L[row, best], near[row, best]
    return np.where(L.min(axis=1) > -1e-9, cells, -1).astype(np.int32), L
