"""Meshes of the same body by fTetWild, an independent mesher, for comparison.

Y. Hu et al., "Fast tetrahedral meshing in the wild", ACM Trans. Graph. 39(4), 2020. Used through
the optional package pytetwild: ``pip install 'palpate[mesh]'``.
fTetWild has no materials, so a tetrahedron gets the tissue at its centroid. It is
not repeatable, so a mesh has to be stored, not regenerated.
"""

from contextlib import chdir
from importlib.util import find_spec
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy import ndimage
from skimage.measure import marching_cubes

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.adaptive.level_set import level_set_of
from palpate.workers.body.mesh.adaptive.mesher import AdaptiveMesh
from palpate.workers.body.mesh.boundary import wall_nodes
from palpate.workers.body.mesh.outline import outline_of
from palpate.workers.body.mesh.quality import volumes_mm3

MISSING = "fTetWild is not installed: pip install 'palpate[mesh]'"
# Distance from the given surfaces, as a fraction of the size; its energy is 3 for a
# regular tetrahedron, and far below 8 it may take for ever.
ENVELOPE, STOP_ENERGY = 0.1, 8.0


def has_tetwild() -> bool:
    """Return True if the package is installed, with pyvista, an undeclared dependency."""
    return find_spec("pytetwild") is not None and find_spec("pyvista") is not None


def tetwild_mesh(labels: Volume, size_mm: float, tissue: Tissue = Tissue.GLANDULAR) -> AdaptiveMesh:
    """Mesh a body so that faces follow the surface of one tissue, within an envelope.

    Parameters
    ----------
    labels : Volume
        `Tissue`; everything but `tissue` and air is one material.
    size_mm : float
        Target length of edges.
    tissue : Tissue

    Raises
    ------
    InputError
        If pytetwild is not installed.
    """
    if not has_tetwild():
        raise InputError(f"{MISSING}.")
    import pytetwild

    outline = outline_of(labels, float(max(labels.spacing_mm)))
    inner = level_set_of(labels, tissue)
    # The body ends at the plane of the wall: there the maximum of both fields is its outline.
    step, wall = outline.frame[1], outline.wall_z_mm
    z = outline.origin_mm[2] + step[2] * np.arange(outline.field.shape[0])
    body = np.maximum(outline.field, (wall - z)[:, None, None])
    vertices, faces = _joined(_surface(body, outline.frame), _surface(inner.field, inner.frame))
    extent = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    # pytetwild leaves a file behind in the current folder.
    with TemporaryDirectory(prefix="palpate-tetwild-") as scratch, chdir(scratch):
        points, tets = pytetwild.tetrahedralize(
            vertices, faces, optimize=True, edge_length_fac=size_mm / extent,
            epsilon=ENVELOPE * size_mm / extent, stop_energy=STOP_ENERGY, num_threads=1, quiet=True,
        )  # fmt: skip
    mesh = _upright(TetMesh(np.asarray(points, np.float64), np.asarray(tets, np.int32)))
    centroids = mesh.nodes[mesh.tets].mean(axis=1)
    kept = _sampled(body, outline.frame, centroids) < 0
    mesh = TetMesh(mesh.nodes, mesh.tets[kept])
    inside = _sampled(inner.field, inner.frame, centroids[kept]) < 0
    return AdaptiveMesh(mesh, inside, wall_nodes(mesh.nodes, wall))


def _surface(field: Any, frame: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the triangles of the zero level, closed at the edge of the samples."""
    padded = np.pad(field, 1, constant_values=float(np.abs(field).max()))
    at, faces, _, _ = marching_cubes(padded, 0.0)
    return frame[0] + (at[:, ::-1] - 1) * frame[1], faces.astype(np.int32)


def _joined(
    first: tuple[FloatArray, IntArray], second: tuple[FloatArray, IntArray]
) -> tuple[FloatArray, IntArray]:
    (a, faces_a), (b, faces_b) = first, second
    return np.concatenate([a, b]), np.concatenate([faces_a, faces_b + len(a)])


def _upright(mesh: TetMesh) -> TetMesh:
    """Return tetrahedra of positive volume, without flat ones."""
    volume = volumes_mm3(mesh)
    turned = np.where((volume < 0)[:, None], mesh.tets[:, [0, 2, 1, 3]], mesh.tets)
    return TetMesh(mesh.nodes, turned[np.abs(volume) > 1e-12])


def _sampled(field: Any, frame: FloatArray, at_mm: FloatArray) -> FloatArray:
    index = ((at_mm - frame[0]) / frame[1])[:, ::-1].T
    return np.asarray(ndimage.map_coordinates(field, index, order=1, mode="nearest"))
