r"""A skin: an incompressible neo-Hookean membrane on the six-node faces.

.. math:: W = \frac{E t}{6} (\operatorname{tr} C + 1 / \det C - 3)

per area, C the 2 x 2 Cauchy-Green tensor of the surface (G. A. Holzapfel, Nonlinear Solid
Mechanics, 2000, section 6.5, in plane stress). It resists compression as well.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.blind.solver.quadratic_element import (
    FACE_EDGES,
    FACE_POINTS,
    FACE_WEIGHTS,
    QuadraticMesh,
    face_areas,
)
from palpate.workers.compile_flags import CONTRACTED


class Sheet(NamedTuple):
    """Faces with their shape in the undeformed body.

    Parameters
    ----------
    faces : ndarray of int32, shape (k, 6)
    tangents : ndarray, shape (k, 3, 2)
        Two orthogonal directions in each face.
    slopes : ndarray, shape (k, 6, 6, 2)
        In-plane gradients of the six shape functions at the six points, in 1/mm.
    areas : ndarray, shape (k, 6)
        Area of each point, in mm^2.
    stiffness : float
        E t / 6 in N/mm.
    """

    faces: IntArray
    tangents: FloatArray
    slopes: FloatArray
    areas: FloatArray
    stiffness: float


def sheet_of(mesh: QuadraticMesh, stiffness_n_per_mm: float) -> Sheet:
    """Return a skin of stiffness E t on the free surface."""
    x = mesh.nodes[mesh.skin[:, :3]]
    edges = np.swapaxes(x[:, 1:] - x[:, :1], 1, 2)
    tangents, triangular = np.linalg.qr(edges)
    # Gradients of the area coordinates within the face.
    last = np.linalg.inv(triangular)
    area = np.concatenate([-last.sum(axis=1, keepdims=True), last], axis=1)
    L = FACE_POINTS
    corner = (4 * L - 1)[None, :, :, None] * area[:, None]
    a, b = FACE_EDGES.T
    middle = 4 * (L[None, :, a, None] * area[:, None, b] + L[None, :, b, None] * area[:, None, a])
    return Sheet(
        np.ascontiguousarray(mesh.skin),
        np.ascontiguousarray(tangents),
        np.ascontiguousarray(np.concatenate([corner, middle], axis=2)),
        face_areas(mesh, mesh.skin)[:, None] * FACE_WEIGHTS,
        stiffness_n_per_mm / 6,
    )


@njit(**CONTRACTED)
def _surface(
    sheet: Sheet, f: int, q: int, u: FloatArray, F: FloatArray
) -> tuple[float, float, float, float]:
    """Store the membrane's deformation gradient (3, 2); return c00, c11, c01 and det C."""
    for i in range(3):
        for k in range(2):
            F[i, k] = sheet.tangents[f, i, k]
            for a in range(6):
                F[i, k] += u[sheet.faces[f, a], i] * sheet.slopes[f, q, a, k]
    c00 = F[0, 0] ** 2 + F[1, 0] ** 2 + F[2, 0] ** 2
    c11 = F[0, 1] ** 2 + F[1, 1] ** 2 + F[2, 1] ** 2
    c01 = F[0, 0] * F[0, 1] + F[1, 0] * F[1, 1] + F[2, 0] * F[2, 1]
    return c00, c11, c01, c00 * c11 - c01 * c01


@njit(**CONTRACTED)
def sheet_energy(sheet: Sheet, u: FloatArray) -> float:
    """Return the energy in mJ; infinite if the membrane is inverted."""
    F = np.empty((3, 2))
    total = 0.0
    for f in range(len(sheet.faces)):
        for q in range(6):
            c00, c11, _, d = _surface(sheet, f, q, u, F)
            if not d > 1e-6:
                return np.inf
            total += sheet.areas[f, q] * sheet.stiffness * (c00 + c11 + 1 / d - 3)
    return total


@njit(**CONTRACTED)
def add_sheet(
    sheet: Sheet, u: FloatArray, slots: IntArray, force: FloatArray, blocks: FloatArray
) -> None:
    """Add the first derivative to `force` (n, 3) and the second to `blocks` (b, 3, 3)."""
    F, A, M, P = np.empty((3, 2)), np.empty((3, 2)), np.empty((2, 2)), np.empty((3, 3))
    An = np.empty((6, 3))
    for f in range(len(sheet.faces)):
        for q in range(6):
            c00, c11, c01, d = _surface(sheet, f, q, u, F)
            M[0, 0], M[1, 1], M[0, 1], M[1, 0] = c11 / d, c00 / d, -c01 / d, -c01 / d
            for i in range(3):
                for k in range(2):
                    A[i, k] = F[i, 0] * M[0, k] + F[i, 1] * M[1, k]
            for i in range(3):
                for j in range(3):
                    P[i, j] = A[i, 0] * F[j, 0] + A[i, 1] * F[j, 1]
            w = 2 * sheet.areas[f, q] * sheet.stiffness
            slopes = sheet.slopes[f, q]
            for a in range(6):
                n = sheet.faces[f, a]
                for i in range(3):
                    An[a, i] = A[i, 0] * slopes[a, 0] + A[i, 1] * slopes[a, 1]
                    Fa = F[i, 0] * slopes[a, 0] + F[i, 1] * slopes[a, 1]
                    force[n, i] += w * (Fa - An[a, i] / d)
            for a in range(6):
                for b in range(6):
                    dot = slopes[a, 0] * slopes[b, 0] + slopes[a, 1] * slopes[b, 1]
                    held = 0.0
                    for k in range(2):
                        held += slopes[a, k] * (M[k, 0] * slopes[b, 0] + M[k, 1] * slopes[b, 1])
                    s = slots[f, a, b]
                    for i in range(3):
                        blocks[s, i, i] += w * (dot - held / d)
                        for j in range(3):
                            blocks[s, i, j] += (w / d) * (
                                2 * An[a, i] * An[b, j] + P[i, j] * held + An[b, i] * An[a, j]
                            )
