r"""Energy, force and tangent of a body of linear tetrahedra.

Each element carries an isochoric matrix, neo-Hooke's or Yeoh's, and up to two
families of fibres,

.. math:: W_e = \tfrac{\mu}{2}(\bar I_1 - 3) + c_2 (\bar I_1 - 3)^2
          + \sum_f \tfrac{\eta_f}{2}(I_{4f} - 1)^2 , \quad \bar I_1 = J^{-2/3} I_1 ,

and each node a volume ratio, averaged over the elements around it, that stores

.. math:: W_n = \tfrac{\kappa_n}{2} (v_n / V_n - 1)^2 .

The nodal average (Bonet & Burton 1998) keeps linear tetrahedra from locking at
nu = 0.49. The tangent is the sum of 3 x 3 blocks over the edges of the mesh and
of a rank-one term per node, ``sum_n (kappa_n / V_n) g_n g_n^T`` with
``g_n = d v_n / d u``; the second is kept apart, because assembling it would
couple nodes two edges away.

A row of K holds, for the edge i-j, the nine entries of the 3 x 3 block
(row-major); a row of B holds the three of ``d v_j / d u_i``.

A fibre may be measured by :math:`\bar I_4 = J^{-2/3} I_4` instead. Every one of
these is a function of an invariant :math:`\varphi(J)\, F A : F` (A = 1, or the dyad
of the fibre), so one set of derivatives serves them all.

With `plain` set each element carries its own ``kappa/2 (J - 1)^2`` instead, the
textbook linear tetrahedron; it locks, and serves to be compared with.

Below J = 0.2 the factor :math:`J^{-2/3}` continues as a parabola, twice
continuously differentiable, so that a trial step may invert an element.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from storage.values import FloatArray, IntArray

Float32Array = NDArray[np.float32]

# No reassociation: it lets LLVM vectorise the short loops with gathers, five times slower.
FLAGS = {"contract", "nsz"}
COMPILE = {"cache": True, "nogil": True, "fastmath": FLAGS, "error_model": "numpy"}

J_SMALL = 0.2
_PHI0 = J_SMALL ** (-2.0 / 3.0)
_PHI1 = -2.0 / 3.0 * _PHI0 / J_SMALL
_PHI2 = 10.0 / 9.0 * _PHI0 / J_SMALL**2


class Elements(NamedTuple):
    """Tetrahedra, (m, 4), gradients of their last three shape functions, (m, 3, 3), volumes."""

    tets: IntArray
    gradients: FloatArray
    volumes: FloatArray


class Matter(NamedTuple):
    """What the elements are made of.

    Parameters
    ----------
    mu, c2, kappa : ndarray, shape (m,)
        MPa.
    eta : ndarray, shape (m, families), and fibre : ndarray, shape (m, families, 3)
        Stiffness in MPa and direction of the fibres.
    tension_only, isochoric_fibre, plain : bool
        See `workers.fem.problem.Problem`.
    """

    mu: FloatArray
    c2: FloatArray
    kappa: FloatArray
    eta: FloatArray
    fibre: FloatArray
    tension_only: bool
    isochoric_fibre: bool
    plain: bool


@njit(inline="always", **COMPILE)
def _isochoric_factor(J: float) -> tuple[float, float, float]:
    """J^(-2/3) and its logarithmic derivatives J phi', J^2 phi''."""
    if J >= J_SMALL:
        c = 1.0 / np.cbrt(J)
        phi = c * c
        return phi, -2.0 / 3.0 * phi, 10.0 / 9.0 * phi
    s = J - J_SMALL
    slope = _PHI1 + _PHI2 * s
    return _PHI0 + _PHI1 * s + 0.5 * _PHI2 * s * s, slope * J, _PHI2 * J * J


@njit(**COMPILE)
def shape_gradients(nodes: FloatArray, tets: IntArray) -> tuple[FloatArray, FloatArray]:
    """Gradients of the last three shape functions, (m, 3, 3), and volumes, (m,).

    The first gradient is minus the sum of the others.
    """
    m = tets.shape[0]
    gradients = np.empty((m, 3, 3))
    volumes = np.empty(m)
    D = np.empty((3, 3))
    for e in range(m):
        for a in range(3):
            for i in range(3):
                D[a, i] = nodes[tets[e, a + 1], i] - nodes[tets[e, 0], i]
        c00 = D[1, 1] * D[2, 2] - D[1, 2] * D[2, 1]
        c01 = D[1, 2] * D[2, 0] - D[1, 0] * D[2, 2]
        c02 = D[1, 0] * D[2, 1] - D[1, 1] * D[2, 0]
        det = D[0, 0] * c00 + D[0, 1] * c01 + D[0, 2] * c02
        volumes[e] = det / 6.0
        r = 1.0 / det
        gradients[e, 0, 0] = c00 * r
        gradients[e, 0, 1] = c01 * r
        gradients[e, 0, 2] = c02 * r
        gradients[e, 1, 0] = (D[0, 2] * D[2, 1] - D[0, 1] * D[2, 2]) * r
        gradients[e, 1, 1] = (D[0, 0] * D[2, 2] - D[0, 2] * D[2, 0]) * r
        gradients[e, 1, 2] = (D[0, 1] * D[2, 0] - D[0, 0] * D[2, 1]) * r
        gradients[e, 2, 0] = (D[0, 1] * D[1, 2] - D[0, 2] * D[1, 1]) * r
        gradients[e, 2, 1] = (D[0, 2] * D[1, 0] - D[0, 0] * D[1, 2]) * r
        gradients[e, 2, 2] = (D[0, 0] * D[1, 1] - D[0, 1] * D[1, 0]) * r
    return gradients, volumes


@njit(inline="always", **COMPILE)
def _deformation_gradient(
    x: FloatArray, tets: IntArray, gradients: FloatArray, e: int, F: FloatArray
) -> None:
    n0, n1, n2, n3 = tets[e, 0], tets[e, 1], tets[e, 2], tets[e, 3]
    for i in range(3):
        o = x[n0, i]
        d1 = x[n1, i] - o
        d2 = x[n2, i] - o
        d3 = x[n3, i] - o
        for j in range(3):
            F[i, j] = d1 * gradients[e, 0, j] + d2 * gradients[e, 1, j] + d3 * gradients[e, 2, j]


@njit(inline="always", **COMPILE)
def _determinant(F: FloatArray) -> float:
    return (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        + F[0, 1] * (F[1, 2] * F[2, 0] - F[1, 0] * F[2, 2])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


@njit(**COMPILE)
def deformation_gradients(x: FloatArray, elements: Elements) -> FloatArray:
    """F of each element, shape (m, 3, 3)."""
    F = np.empty((elements.tets.shape[0], 3, 3))
    for e in range(F.shape[0]):
        _deformation_gradient(x, elements.tets, elements.gradients, e, F[e])
    return F


@njit(**COMPILE)
def energy(x: FloatArray, elements: Elements, matter: Matter, nodal_volumes: FloatArray) -> float:
    """Energy of the elements in mJ; `nodal_volumes` receives v_n in mm^3."""
    tets, volumes, fibre = elements.tets, elements.volumes, matter.fibre
    F = np.empty((3, 3))
    total = 0.0
    nodal_volumes[:] = 0.0
    for e in range(tets.shape[0]):
        _deformation_gradient(x, tets, elements.gradients, e, F)
        J = _determinant(F)
        I1 = 0.0
        for i in range(3):
            I1 += F[i, 0] * F[i, 0] + F[i, 1] * F[i, 1] + F[i, 2] * F[i, 2]
        phi, _, _ = _isochoric_factor(J)
        s = phi * I1 - 3.0
        density = (0.5 * matter.mu[e] + matter.c2[e] * s) * s
        for q in range(fibre.shape[1]):
            I4 = 0.0
            for i in range(3):
                w = F[i, 0] * fibre[e, q, 0] + F[i, 1] * fibre[e, q, 1] + F[i, 2] * fibre[e, q, 2]
                I4 += w * w
            stretch = (phi * I4 if matter.isochoric_fibre else I4) - 1.0
            if not (matter.tension_only and stretch < 0.0):
                density += 0.5 * matter.eta[e, q] * stretch * stretch
        if matter.plain:
            density += 0.5 * matter.kappa[e] * (J - 1.0) * (J - 1.0)
        v = volumes[e]
        total += v * density
        share = 0.25 * J * v
        for a in range(4):
            nodal_volumes[tets[e, a]] += share
    return total


@njit(**COMPILE)
def smallest_volume_ratio(x: FloatArray, elements: Elements) -> float:
    """Smallest J over the elements."""
    F = np.empty((3, 3))
    smallest = np.inf
    for e in range(elements.tets.shape[0]):
        _deformation_gradient(x, elements.tets, elements.gradients, e, F)
        smallest = min(smallest, _determinant(F))
    return smallest


@njit(inline="always", **COMPILE)
def _inverse_transpose(F: FloatArray, H: FloatArray) -> float:
    """Write F^-T into `H` and return J."""
    H[0, 0] = F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1]
    H[0, 1] = F[1, 2] * F[2, 0] - F[1, 0] * F[2, 2]
    H[0, 2] = F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0]
    H[1, 0] = F[0, 2] * F[2, 1] - F[0, 1] * F[2, 2]
    H[1, 1] = F[0, 0] * F[2, 2] - F[0, 2] * F[2, 0]
    H[1, 2] = F[0, 1] * F[2, 0] - F[0, 0] * F[2, 1]
    H[2, 0] = F[0, 1] * F[1, 2] - F[0, 2] * F[1, 1]
    H[2, 1] = F[0, 2] * F[1, 0] - F[0, 0] * F[1, 2]
    H[2, 2] = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    J = F[0, 0] * H[0, 0] + F[0, 1] * H[0, 1] + F[0, 2] * H[0, 2]
    r = 1.0 / J if J != 0.0 else 0.0
    for i in range(3):
        for j in range(3):
            H[i, j] *= r
    return J


@njit(**COMPILE)
def assemble(
    x: FloatArray,
    elements: Elements,
    matter: Matter,
    pressure: FloatArray,
    edge: IntArray,
    convex: bool,
    force: FloatArray,
    K: Float32Array,
    B: Float32Array,
) -> None:
    """Add the internal force, (n, 3) in N, and the tangent, K (edges, 9) and B (edges, 3).

    `pressure` is ``kappa_n (v_n / V_n - 1)`` per node; `edge`, (m, 4, 4), is the
    row of K and B of each pair of nodes. With `convex` the geometric
    stiffness of pressure and slack fibres, which may be negative, is left out.
    With an empty K the force alone is added.
    """
    tets, gradients, fibre = elements.tets, elements.gradients, matter.fibre
    families = fibre.shape[1]
    F = np.empty((3, 3))
    H = np.empty((3, 3))
    g = np.empty((4, 3))
    f = np.empty((4, 3))
    h = np.empty((4, 3))
    t = np.empty((4, 3))
    diagonal = np.empty((4, 4))
    rank_one = np.empty(families + 1)
    r = np.empty((families + 1, 4, 3))
    z = np.empty(4)
    w = np.empty(3)
    for e in range(tets.shape[0]):
        _deformation_gradient(x, tets, gradients, e, F)
        J = _inverse_transpose(F, H)
        I1 = 0.0
        for i in range(3):
            for j in range(3):
                I1 += F[i, j] * F[i, j]
        for j in range(3):
            g[1, j] = gradients[e, 0, j]
            g[2, j] = gradients[e, 1, j]
            g[3, j] = gradients[e, 2, j]
            g[0, j] = -(g[1, j] + g[2, j] + g[3, j])
        v = elements.volumes[e]
        phi0, phi1, phi2 = _isochoric_factor(J)
        s = phi0 * I1 - 3.0
        weight = (matter.mu[e] + 4.0 * matter.c2[e] * s) * v
        m0, m1, m2 = weight * phi0, weight * phi1, weight * phi2
        p = 0.25 * (
            pressure[tets[e, 0]]
            + pressure[tets[e, 1]]
            + pressure[tets[e, 2]]
            + pressure[tets[e, 3]]
        )
        stiffening = 0.0
        if matter.plain:
            p = matter.kappa[e] * (J - 1.0)
            stiffening = matter.kappa[e] * J * J * v
        pJ = p * J * v
        normal = 0.5 * m1 * I1 + pJ
        for a in range(4):
            n = tets[e, a]
            for i in range(3):
                f[a, i] = F[i, 0] * g[a, 0] + F[i, 1] * g[a, 1] + F[i, 2] * g[a, 2]
                h[a, i] = H[i, 0] * g[a, 0] + H[i, 1] * g[a, 1] + H[i, 2] * g[a, 2]
                t[a, i] = m1 * f[a, i]
                force[n, i] += m0 * f[a, i] + normal * h[a, i]
        if convex:
            pJ = 0.0
        straight = 0.5 * I1 * (m1 + m2) + pJ + stiffening
        crossed = -0.5 * m1 * I1 - pJ
        for a in range(3):
            for b in range(a + 1, 4):
                diagonal[a, b] = m0 * (g[a, 0] * g[b, 0] + g[a, 1] * g[b, 1] + g[a, 2] * g[b, 2])
        ranks = 0
        if matter.c2[e] != 0.0:
            rank_one[0] = 8.0 * matter.c2[e] * v
            for a in range(4):
                for i in range(3):
                    r[0, a, i] = phi0 * f[a, i] + 0.5 * phi1 * I1 * h[a, i]
            ranks = 1
        for q in range(families):
            eta = matter.eta[e, q]
            if eta == 0.0:
                continue
            I4 = 0.0
            for i in range(3):
                w[i] = (
                    F[i, 0] * fibre[e, q, 0] + F[i, 1] * fibre[e, q, 1] + F[i, 2] * fibre[e, q, 2]
                )
                I4 += w[i] * w[i]
            p0, p1, p2 = 1.0, 0.0, 0.0
            if matter.isochoric_fibre:
                p0, p1, p2 = phi0, phi1, phi2
            stretch = p0 * I4 - 1.0
            if matter.tension_only and stretch < 0.0:
                continue
            c = 2.0 * eta * v * stretch
            for a in range(4):
                z[a] = (
                    g[a, 0] * fibre[e, q, 0] + g[a, 1] * fibre[e, q, 1] + g[a, 2] * fibre[e, q, 2]
                )
                for i in range(3):
                    r[ranks, a, i] = p0 * z[a] * w[i] + 0.5 * p1 * I4 * h[a, i]
                    force[tets[e, a], i] += c * r[ranks, a, i]
            if convex:
                c = max(c, 0.0)
            straight += 0.5 * I4 * c * (p1 + p2)
            crossed -= 0.5 * I4 * c * p1
            for a in range(4):
                for i in range(3):
                    t[a, i] += c * p1 * z[a] * w[i]
            for a in range(3):
                for b in range(a + 1, 4):
                    diagonal[a, b] += c * p0 * z[a] * z[b]
            rank_one[ranks] = 4.0 * eta * v
            ranks += 1
        if K.shape[0] == 0:
            continue
        for a in range(3):
            for b in range(a + 1, 4):
                upper = edge[e, a, b]
                lower = edge[e, b, a]
                here = edge[e, a, a]
                there = edge[e, b, b]
                for i in range(3):
                    left = straight * h[a, i] + t[a, i]
                    turned = crossed * h[b, i]
                    for k in range(3):
                        value = left * h[b, k] + h[a, i] * t[b, k] + turned * h[a, k]
                        for q in range(ranks):
                            value += rank_one[q] * r[q, a, i] * r[q, b, k]
                        if i == k:
                            value += diagonal[a, b]
                        K[upper, 3 * i + k] += value
                        K[lower, 3 * k + i] += value
                        # Rigid translations cost nothing: rows of the element sum to zero.
                        K[here, 3 * i + k] -= value
                        K[there, 3 * k + i] -= value
        share = 0.25 * J * v
        for a in range(4):
            s0 = share * h[a, 0]
            s1 = share * h[a, 1]
            s2 = share * h[a, 2]
            for b in range(4):
                q = edge[e, a, b]
                B[q, 0] += s0
                B[q, 1] += s1
                B[q, 2] += s2
