"""Agreement of a mesh of two tissues with the voxels it was made from."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import BoolArray, FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.quality import volumes_mm3
from palpate.workers.compile_flags import EXACT

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
    found = np.zeros(shape, np.uint8)
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
                        found[k, j, i] = INSIDE if inside[m] else OTHER
    return found
