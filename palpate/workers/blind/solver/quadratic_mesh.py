r"""Quadratic tetrahedra made from linear ones, integration points, and their fine linear parts.

With barycentric coordinates L the ten shape functions are

.. math:: N_a = L_a (2 L_a - 1) , \quad N_{ab} = 4 L_a L_b

(O. C. Zienkiewicz, R. L. Taylor, The Finite Element Method, vol. 1, section 6.4).
Edges are straight, so the gradients of L are constant in an element. Fine linear tetrahedra follow
the curved faces of the deformed mesh.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from palpate.storage.values import FloatArray, IntArray, TetMesh

EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
"""Corners of the edges whose midpoints are the nodes 4 to 9 of a tetrahedron."""

FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
"""Corners of the faces, counter-clockwise seen from outside."""

FACE_EDGES = np.array([[0, 1], [1, 2], [2, 0]])

# Four points, exact for quadratic polynomials (Zienkiewicz and Taylor, table 5.3).
_A, _B = (5 + 3 * np.sqrt(5)) / 20, (5 - np.sqrt(5)) / 20
POINTS = np.full((4, 4), _B) + (_A - _B) * np.eye(4)

# Six points, exact for polynomials of degree 4 (D. A. Dunavant, Int. J. Numer. Methods
# Eng. 21 (1985) 1129-1148).
_P, _Q = 0.445948490915965, 0.091576213509771
FACE_POINTS = np.array([
    [1 - 2 * _P, _P, _P], [_P, 1 - 2 * _P, _P], [_P, _P, 1 - 2 * _P],
    [1 - 2 * _Q, _Q, _Q], [_Q, 1 - 2 * _Q, _Q], [_Q, _Q, 1 - 2 * _Q],
])  # fmt: skip
FACE_WEIGHTS = np.repeat([0.223381589678011, 0.109951743655322], 3)


@dataclass(frozen=True, eq=False)
class QuadraticMesh:
    """Mesh of tetrahedra with ten nodes.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
        Positions in mm; the corners come first, then the mid-edge nodes.
    cells : ndarray of int32, shape (m, 10)
        Four corners, then the mid-edge nodes in the order of `EDGES`.
    ends : ndarray of int32, shape (n, 2)
        The two corners next to each node; for a corner, the corner itself twice.
    skin, wall : ndarray of int32, shape (k, 6)
        Faces of the free surface and of the chest wall: three corners, counter-clockwise
        seen from outside, then the mid-edge nodes in the order of `FACE_EDGES`.
    """

    nodes: FloatArray
    cells: IntArray
    ends: IntArray
    skin: IntArray
    wall: IntArray

    @property
    def corners(self) -> int:
        """Return the number of corners."""
        return int(np.count_nonzero(self.ends[:, 0] == self.ends[:, 1]))


def quadratic(nodes: FloatArray, tets: IntArray, wall_z_mm: float) -> QuadraticMesh:
    """Add a node at the midpoint of every edge.

    Parameters
    ----------
    nodes : ndarray, shape (c, 3)
    tets : ndarray of int, shape (m, 4)
        Positively oriented tetrahedra.
    wall_z_mm : float
        Faces in this plane form the wall; all others are free.
    """
    count = len(nodes)
    pairs = np.sort(tets[:, EDGES].reshape(-1, 2), axis=1)
    edges, owner = np.unique(pairs, axis=0, return_inverse=True)
    middles = count + owner.reshape(len(tets), 6)
    own = np.repeat(np.arange(count)[:, None], 2, axis=1)
    ends = np.vstack([own, edges])
    faces = _boundary(tets)
    number = {(int(a), int(b)): count + e for e, (a, b) in enumerate(edges)}
    middle = [
        [number[min(f[a], f[b]), max(f[a], f[b])] for a, b in FACE_EDGES] for f in faces.tolist()
    ]
    faces = np.hstack([faces, np.array(middle)]).astype(np.int32)
    flat = (np.abs(nodes[faces[:, :3], 2] - wall_z_mm) < 1e-9).all(axis=1)
    return QuadraticMesh(
        np.vstack([nodes, nodes[edges].mean(axis=1)]),
        np.hstack([tets, middles]).astype(np.int32),
        ends.astype(np.int32),
        faces[~flat],
        faces[flat],
    )


def _boundary(tets: IntArray) -> NDArray[np.int64]:
    """Return the faces that belong to a single tetrahedron, shape (k, 3)."""
    faces = tets[:, FACES].reshape(-1, 3).astype(np.int64)
    _, index, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    return np.asarray(faces[np.sort(index[count == 1])])


def gradients(mesh: QuadraticMesh) -> tuple[FloatArray, FloatArray]:
    """Return gradients of barycentric coordinates, (m, 4, 3) in 1/mm, and volumes (m,) in mm^3."""
    x = mesh.nodes[mesh.cells[:, :4]]
    edges = x[:, 1:] - x[:, :1]
    inverse = np.linalg.inv(edges)
    last = np.swapaxes(inverse, 1, 2)
    first = -last.sum(axis=1, keepdims=True)
    return np.concatenate([first, last], axis=1), np.linalg.det(edges) / 6


def points_in_cells(mesh: QuadraticMesh) -> FloatArray:
    """Return the positions of the integration points, shape (m, 4, 3) in mm."""
    return np.asarray(np.einsum("qa,mai->mqi", POINTS, mesh.nodes[mesh.cells[:, :4]]))


def face_shapes() -> FloatArray:
    """Return the six shape functions at the six points of a face, shape (6 points, 6)."""
    L = FACE_POINTS
    middle = 4 * L[:, FACE_EDGES[:, 0]] * L[:, FACE_EDGES[:, 1]]
    return np.hstack([L * (2 * L - 1), middle])


def face_areas(mesh: QuadraticMesh, faces: IntArray) -> FloatArray:
    """Return the areas of faces, shape (k,) in mm^2."""
    x = mesh.nodes[faces[:, :3]]
    return np.asarray(0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1))


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
