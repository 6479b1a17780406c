"""Comparison of meshes of two tissues: plane sections, and agreement with the voxels."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.mesh_geometry import volumes_mm3
from palpate.workers.kernels_and_threads import EXACT

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
    polygons, owners = [], []
    for wanted in (1, 2, 3):
        tets = np.flatnonzero(count == wanted)
        # The corners of the smaller side first; if both have two, those above.
        sides = above[tets] if wanted < 3 else ~above[tets]
        order = np.argsort(~sides, axis=1, kind="stable")
        corners = np.take_along_axis(mesh.tets[tets], order, axis=1)
        edges = QUADRANGLE if wanted == 2 else ((0, 1), (0, 2), (0, 3), (0, 3))
        polygons.append(np.stack([_crossing(corners, e, height, flat) for e in edges], axis=1))
        owners.append(tets)
    return PlaneSection(np.concatenate(polygons), np.concatenate(owners))


def _crossing(
    corners: IntArray, edge: tuple[int, int], height: FloatArray, flat: FloatArray
) -> FloatArray:
    """Return the intersection of the plane with an edge of each tetrahedron, shape (m, 2)."""
    i, j = corners[:, edge[0]], corners[:, edge[1]]
    share = (height[i] / (height[i] - height[j]))[:, None]
    return np.asarray(flat[i] + share * (flat[j] - flat[i]))


OUTSIDE, OTHER, INSIDE = 0, 1, 2
ON_A_FACE = 1e-9  # barycentric weight that still counts as inside


@dataclass(frozen=True)
class Agreement:
    """Agreement of a mesh with voxels.

    Parameters
    ----------
    labels : float
        Fraction of the body's voxels whose centre is in a tetrahedron of their own material;
        a centre outside the mesh does not agree.
    tissue_volume : float
        Volume of the tissue in the mesh over the volume of its voxels, minus one.
    body_volume : float
        The same for the whole body.
    """

    labels: float
    tissue_volume: float
    body_volume: float


def agreement(
    mesh: TetMesh, inside: BoolArray, labels: Volume, tissue: Tissue = Tissue.GLANDULAR
) -> Agreement:
    """Compare a mesh with its voxels; all tissues but one count as the same material.

    Parameters
    ----------
    mesh : TetMesh
    inside : ndarray of bool, shape (m,)
        Tetrahedra of the tissue.
    labels : Volume
    tissue : Tissue
    """
    material = np.where(labels.values == Tissue.AIR, OUTSIDE, OTHER).astype(np.uint8)
    material[labels.values == tissue] = INSIDE
    spacing = np.asarray(labels.spacing_mm, np.float64)
    meshed = _materials(
        (mesh.nodes - np.asarray(labels.origin_mm)) / spacing, mesh.tets, inside, material.shape
    )
    body = material != OUTSIDE
    volumes = volumes_mm3(mesh)
    voxels = np.bincount(material.ravel(), minlength=3) * labels.voxel_mm3
    return Agreement(
        labels=float(np.mean(meshed[body] == material[body])),
        tissue_volume=float(volumes[inside].sum() / voxels[INSIDE] - 1),
        body_volume=float(volumes.sum() / (voxels[OTHER] + voxels[INSIDE]) - 1),
    )


@njit(**EXACT)
def _materials(
    nodes: FloatArray, tets: IntArray, inside: BoolArray, shape: tuple[int, int, int]
) -> NDArray[np.uint8]:
    """Return the material of the tetrahedron at each voxel centre; nodes are in voxels."""
    materials = np.zeros(shape, np.uint8)
    nz, ny, nx = shape
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for m in range(len(tets)):
        p = nodes[tets[m, 0]]
        a, b, c = nodes[tets[m, 1]] - p, nodes[tets[m, 2]] - p, nodes[tets[m, 3]] - p
        bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
        det = a[0] * bc[0] + a[1] * bc[1] + a[2] * bc[2]
        for axis in range(3):
            least = p[axis] + min(0.0, a[axis], b[axis], c[axis])
            most = p[axis] + max(0.0, a[axis], b[axis], c[axis])
            low[axis] = max(0, int(np.ceil(least)))
            high[axis] = int(np.floor(most))
        for k in range(low[2], min(high[2], nz - 1) + 1):
            for j in range(low[1], min(high[1], ny - 1) + 1):
                for i in range(low[0], min(high[0], nx - 1) + 1):
                    x, y, z = i - p[0], j - p[1], k - p[2]
                    u = (x * bc[0] + y * bc[1] + z * bc[2]) / det
                    v = (x * ca[0] + y * ca[1] + z * ca[2]) / det
                    w = (x * ab[0] + y * ab[1] + z * ab[2]) / det
                    if min(u, v, w, 1.0 - u - v - w) >= -ON_A_FACE:
                        materials[k, j, i] = INSIDE if inside[m] else OTHER
    return materials
