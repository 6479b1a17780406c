r"""Energy, force and tangent of the tissue, quadratic tetrahedra, and of the skin, a membrane.

.. math:: W = \frac{\mu}{2 b} (e^{b (\bar I_1 - 3)} - 1) + \frac{\kappa}{2} (J - 1)^2
          + \frac{\eta}{2} \langle \bar I_4 - 1 \rangle_+^2

at each of four points, with :math:`\bar I = J^{-2/3} I`; the neo-Hookean law is the limit
b -> 0 of Fung's (Y. C. Fung, Biomechanics, 1993, section 8.3). Tissue that has grown by
the stretch g is stress-free at ``F = g 1``.

With G the inverse transpose of F, an invariant :math:`\varphi(J) F A : F` has

.. math:: Q = J^{-2/3} (2 F A - \tfrac23 I G) , \quad
   dQ[H] = -\tfrac23 (G : H) Q + J^{-2/3} (2 H A - \tfrac43 (F A : H) G
           + \tfrac23 I\, G H^T G) .

The skin is an incompressible neo-Hookean membrane on the six-node faces,

.. math:: W = \frac{E t}{6} (\operatorname{tr} C + 1 / \det C - 3)

per area, C the 2 x 2 Cauchy-Green tensor of the surface (G. A. Holzapfel, Nonlinear Solid
Mechanics, 2000, section 6.5, in plane stress). It resists compression as well.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.blind.solver.quadratic_mesh import (
    EDGES,
    FACE_EDGES,
    FACE_POINTS,
    FACE_WEIGHTS,
    POINTS,
    QuadraticMesh,
    face_areas,
    gradients,
)
from palpate.workers.kernels_and_threads import CONTRACTED


class ElementMaterials(NamedTuple):
    """Material constants at the four points of each element.

    Parameters
    ----------
    mu, kappa, eta : ndarray, shape (m, 4)
        In MPa.
    fung : ndarray, shape (m, 4)
        The exponent b; >= 0.
    growth : ndarray, shape (m, 4)
        The stress-free stretch g.
    fibre : ndarray, shape (m, 4, 3)
        Unit vectors.
    """

    mu: FloatArray
    kappa: FloatArray
    eta: FloatArray
    fung: FloatArray
    growth: FloatArray
    fibre: FloatArray


class Cells(NamedTuple):
    """Nodes (m, 10), gradients of the barycentric coordinates (m, 4, 3) and volumes (m,)."""

    nodes: IntArray
    gradients: FloatArray
    volumes: FloatArray


def cells_of(mesh: QuadraticMesh) -> Cells:
    """Return the elements of a mesh in the form used by the kernels."""
    return Cells(np.ascontiguousarray(mesh.cells), *gradients(mesh))


@njit(**CONTRACTED)
def _shape_gradients(slopes: FloatArray, q: int, scale: float, out: FloatArray) -> None:
    """Store the gradients of the ten shape functions at point q, (10, 3)."""
    for a in range(4):
        for k in range(3):
            out[a, k] = (4 * POINTS[q, a] - 1) * slopes[a, k] * scale
    for e in range(6):
        a, b = EDGES[e, 0], EDGES[e, 1]
        for k in range(3):
            out[4 + e, k] = 4 * (POINTS[q, a] * slopes[b, k] + POINTS[q, b] * slopes[a, k]) * scale


@njit(**CONTRACTED)
def _deformation(
    u: FloatArray, nodes: IntArray, dN: FloatArray, scale: float, F: FloatArray
) -> float:
    """Store the part of F that is not growth; return its determinant."""
    for i in range(3):
        for k in range(3):
            F[i, k] = scale if i == k else 0.0
    for a in range(10):
        n = nodes[a]
        for i in range(3):
            for k in range(3):
                F[i, k] += u[n, i] * dN[a, k]
    return (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        - F[0, 1] * (F[1, 0] * F[2, 2] - F[1, 2] * F[2, 0])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


@njit(**CONTRACTED)
def _cofactor(F: FloatArray, J: float, G: FloatArray) -> None:
    """Store the inverse transpose of F, of determinant J."""
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for k in range(3):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            G[i, k] = (F[i1, k1] * F[i2, k2] - F[i1, k2] * F[i2, k1]) / J


@njit(**CONTRACTED)
def _invariants(F: FloatArray, fibre: FloatArray, Fa: FloatArray) -> tuple[float, float]:
    """Return I1 and I4; store the stretched fibre."""
    first, fourth = 0.0, 0.0
    for i in range(3):
        Fa[i] = F[i, 0] * fibre[0] + F[i, 1] * fibre[1] + F[i, 2] * fibre[2]
        fourth += Fa[i] * Fa[i]
        for k in range(3):
            first += F[i, k] * F[i, k]
    return first, fourth


@njit(**CONTRACTED)
def tissue_energy(cells: Cells, materials: ElementMaterials, u: FloatArray) -> float:
    """Return the stored energy in mJ; infinite if an element is inverted."""
    F, Fa, dN = np.empty((3, 3)), np.empty(3), np.empty((10, 3))
    total = 0.0
    for m in range(len(cells.volumes)):
        for q in range(4):
            g = materials.growth[m, q]
            _shape_gradients(cells.gradients[m], q, 1 / g, dN)
            J = _deformation(u, cells.nodes[m], dN, 1 / g, F)
            if not J > 0.02:
                return np.inf
            first, fourth = _invariants(F, materials.fibre[m, q], Fa)
            phi = J ** (-2.0 / 3.0)
            b = materials.fung[m, q]
            x = phi * first - 3
            if b * x > 50:
                return np.inf
            shear = x if b == 0.0 else np.expm1(b * x) / b
            pull = max(phi * fourth - 1, 0.0)
            density = 0.5 * (
                materials.mu[m, q] * shear
                + materials.kappa[m, q] * (J - 1) ** 2
                + materials.eta[m, q] * pull**2
            )
            total += 0.25 * cells.volumes[m] * g**3 * density
    return total


@njit(**CONTRACTED)
def add_tissue_forces(
    cells: Cells, materials: ElementMaterials, u: FloatArray, out: FloatArray
) -> None:
    """Add the gradient of the energy in the nodal positions, in N, to `out` (n, 3)."""
    F, G, Fa, dN = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty((10, 3))
    P = np.empty((3, 3))
    for m in range(len(cells.volumes)):
        for q in range(4):
            g = materials.growth[m, q]
            _shape_gradients(cells.gradients[m], q, 1 / g, dN)
            J = _deformation(u, cells.nodes[m], dN, 1 / g, F)
            _cofactor(F, J, G)
            fibre = materials.fibre[m, q]
            first, fourth = _invariants(F, fibre, Fa)
            phi = J ** (-2.0 / 3.0)
            b = materials.fung[m, q]
            w1 = 0.5 * materials.mu[m, q] * np.exp(b * (phi * first - 3))
            w4 = materials.eta[m, q] * max(phi * fourth - 1, 0.0)
            on_g = materials.kappa[m, q] * (J - 1) * J
            on_g -= 2.0 / 3.0 * phi * (w1 * first + w4 * fourth)
            weight = 0.25 * cells.volumes[m] * g**3
            for i in range(3):
                for k in range(3):
                    P[i, k] = weight * (
                        2 * phi * (w1 * F[i, k] + w4 * Fa[i] * fibre[k]) + on_g * G[i, k]
                    )
            for a in range(10):
                n = cells.nodes[m, a]
                for i in range(3):
                    out[n, i] += P[i, 0] * dN[a, 0] + P[i, 1] * dN[a, 1] + P[i, 2] * dN[a, 2]


@njit(**CONTRACTED)
def add_tissue_tangent(
    cells: Cells, materials: ElementMaterials, u: FloatArray, slots: IntArray, out: FloatArray
) -> None:
    """Add the second derivative to blocks `out` (b, 3, 3), at the indices `slots` (m, 10, 10)."""
    F, G, Fa, dN = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty((10, 3))
    K = np.empty((10, 10, 3, 3))
    # Per node: G dN, the two Q dN and fibre dN.
    gn, q1, q4, an = np.empty((10, 3)), np.empty((10, 3)), np.empty((10, 3)), np.empty(10)
    for m in range(len(cells.volumes)):
        K[:] = 0.0
        for q in range(4):
            g = materials.growth[m, q]
            _shape_gradients(cells.gradients[m], q, 1 / g, dN)
            J = _deformation(u, cells.nodes[m], dN, 1 / g, F)
            _cofactor(F, J, G)
            fibre = materials.fibre[m, q]
            first, fourth = _invariants(F, fibre, Fa)
            phi = J ** (-2.0 / 3.0)
            weight = 0.25 * cells.volumes[m] * g**3
            b, kappa, eta = materials.fung[m, q], materials.kappa[m, q], materials.eta[m, q]
            w1 = 0.5 * weight * materials.mu[m, q] * np.exp(b * (phi * first - 3))
            w11 = b * w1
            pull = phi * fourth - 1
            w4 = weight * eta * max(pull, 0.0)
            w44 = weight * eta if pull > 0 else 0.0
            for a in range(10):
                an[a] = fibre[0] * dN[a, 0] + fibre[1] * dN[a, 1] + fibre[2] * dN[a, 2]
                for i in range(3):
                    f = F[i, 0] * dN[a, 0] + F[i, 1] * dN[a, 1] + F[i, 2] * dN[a, 2]
                    gn[a, i] = G[i, 0] * dN[a, 0] + G[i, 1] * dN[a, 1] + G[i, 2] * dN[a, 2]
                    q1[a, i] = phi * (2 * f - 2.0 / 3.0 * first * gn[a, i])
                    q4[a, i] = phi * (2 * an[a] * Fa[i] - 2.0 / 3.0 * fourth * gn[a, i])
            # d(phi I) twice: -2/3 (g Q + Q g) - 4/9 phi I g g + 2/3 phi I (g g)^T + 2 phi A.
            both = phi * (w1 * first + w4 * fourth)
            volume = weight * kappa
            gg = volume * (2 * J - 1) * J - 4.0 / 9.0 * both
            swapped = 2.0 / 3.0 * both - volume * (J - 1) * J
            for a in range(10):
                for c in range(a, 10):
                    dot = dN[a, 0] * dN[c, 0] + dN[a, 1] * dN[c, 1] + dN[a, 2] * dN[c, 2]
                    straight = 2 * phi * (w1 * dot + w4 * an[a] * an[c])
                    for i in range(3):
                        K[a, c, i, i] += straight
                        left1 = w11 * q1[a, i] - 2.0 / 3.0 * w1 * gn[a, i]
                        left4 = w44 * q4[a, i] - 2.0 / 3.0 * w4 * gn[a, i]
                        right = gg * gn[a, i] - 2.0 / 3.0 * (w1 * q1[a, i] + w4 * q4[a, i])
                        for j in range(3):
                            K[a, c, i, j] += (
                                left1 * q1[c, j]
                                + left4 * q4[c, j]
                                + right * gn[c, j]
                                + swapped * gn[c, i] * gn[a, j]
                            )
        for a in range(10):
            for c in range(a, 10):
                s, t = slots[m, a, c], slots[m, c, a]
                for i in range(3):
                    for j in range(3):
                        out[s, i, j] += K[a, c, i, j]
                        if a != c:
                            out[t, j, i] += K[a, c, i, j]


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
