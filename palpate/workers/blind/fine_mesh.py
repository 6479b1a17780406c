"""Fine linear tetrahedra that follow the curved faces of a quadratic mesh."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.values import FloatArray, IntArray, TetMesh
from palpate.workers.blind.solver.quadratic_element import EDGES, QuadraticMesh

HALVINGS = 2  # of every edge
SAME_MM = 1e-6  # nodes closer than this are merged


@dataclass(frozen=True, eq=False)
class FineMesh:
    """Linear tetrahedra, and the interpolation matrix from the quadratic nodes to their nodes."""

    mesh: TetMesh
    interpolation: csr_matrix


def fine_mesh_of(mesh: QuadraticMesh) -> FineMesh:
    """Cut every element into eight parts, and each part into eight again."""
    places, tets = _cut(HALVINGS)
    shapes = np.hstack(
        [places * (2 * places - 1), 4 * places[:, EDGES[:, 0]] * places[:, EDGES[:, 1]]]
    )
    points = np.einsum("la,mai->mli", places, mesh.nodes[mesh.cells[:, :4]]).reshape(-1, 3)
    key = np.rint(points / SAME_MM).astype(np.int64)
    _, first, owner = np.unique(key, axis=0, return_index=True, return_inverse=True)
    local = np.arange(len(mesh.cells))[:, None, None] * len(places) + tets
    cell, place = np.divmod(first, len(places))
    entries = (shapes[place].ravel(), mesh.cells[cell].ravel(), np.arange(len(first) + 1) * 10)
    return FineMesh(
        TetMesh(points[first], owner.reshape(-1)[local].reshape(-1, 4).astype(np.int32)),
        csr_matrix(entries, shape=(len(first), len(mesh.nodes))),
    )


def _cut(halvings: int) -> tuple[FloatArray, IntArray]:
    """Return the barycentric coordinates of the nodes in a cut element, and its parts."""
    # Four parts are at the corners; the remaining octahedron is cut along the line from 4 to 9.
    parts = np.array([
        [0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3],
        [4, 9, 6, 7], [4, 9, 7, 8], [4, 9, 8, 5], [4, 9, 5, 6],
    ])  # fmt: skip
    corners = np.eye(4)[None]
    for _ in range(halvings):
        nodes = np.concatenate([corners, corners[:, EDGES].mean(axis=2)], axis=1)
        corners = nodes[:, parts].reshape(-1, 4, 4)
    places, owner = np.unique(corners.reshape(-1, 4), axis=0, return_inverse=True)
    return places, owner.reshape(-1, 4).astype(np.int32)
