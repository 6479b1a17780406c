r"""Energy, force and tangent of a body of linear tetrahedra.

Each element carries an isochoric neo-Hookean matrix and one family of fibres,

.. math:: W_e = \tfrac{\mu}{2}(J^{-2/3} I_1 - 3) + \tfrac{\eta}{2}(I_4 - 1)^2 ,

and each node a volume ratio, averaged over the elements around it, that stores

.. math:: W_n = \tfrac{\kappa_n}{2} (v_n / V_n - 1)^2 .

The nodal average (Bonet & Burton 1998) keeps linear tetrahedra from locking at
nu = 0.49. The tangent is the sum of 3 x 3 blocks over the edges of the mesh and
of a rank-one term per node, ``sum_n (kappa_n / V_n) g_n g_n^T`` with
``g_n = d v_n / d u``; the second is kept apart, because assembling it would
couple nodes two edges away.

A row of K holds, for the edge i-j, the nine entries of the 3 x 3 block
(row-major); a row of B holds the three of ``d v_j / d u_i``.

With `plain` set each element carries its own ``kappa/2 (J - 1)^2`` instead, the
textbook linear tetrahedron; it locks, and serves to be compared with.

Below J = 0.2 the factor :math:`J^{-2/3}` continues as a parabola, twice
continuously differentiable, so that a trial step may invert an element.
"""

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
def energy(
    x: FloatArray,
    tets: IntArray,
    gradients: FloatArray,
    volumes: FloatArray,
    mu: FloatArray,
    eta: FloatArray,
    kappa: FloatArray,
    plain: bool,
    fibre: FloatArray,
    tension_only: bool,
    nodal_volumes: FloatArray,
) -> float:
    """Energy of the elements in mJ; `nodal_volumes` receives v_n in mm^3."""
    F = np.empty((3, 3))
    total = 0.0
    nodal_volumes[:] = 0.0
    for e in range(tets.shape[0]):
        _deformation_gradient(x, tets, gradients, e, F)
        J = _determinant(F)
        I1 = 0.0
        I4 = 0.0
        for i in range(3):
            I1 += F[i, 0] * F[i, 0] + F[i, 1] * F[i, 1] + F[i, 2] * F[i, 2]
            w = F[i, 0] * fibre[0] + F[i, 1] * fibre[1] + F[i, 2] * fibre[2]
            I4 += w * w
        stretch = I4 - 1.0
        if tension_only and stretch < 0.0:
            stretch = 0.0
        phi, _, _ = _isochoric_factor(J)
        v = volumes[e]
        total += v * (0.5 * mu[e] * (phi * I1 - 3.0) + 0.5 * eta[e] * stretch * stretch)
        if plain:
            total += 0.5 * v * kappa[e] * (J - 1.0) * (J - 1.0)
        share = 0.25 * J * v
        for a in range(4):
            nodal_volumes[tets[e, a]] += share
    return total


@njit(**COMPILE)
def smallest_volume_ratio(x: FloatArray, tets: IntArray, gradients: FloatArray) -> float:
    """Smallest J over the elements."""
    F = np.empty((3, 3))
    smallest = np.inf
    for e in range(tets.shape[0]):
        _deformation_gradient(x, tets, gradients, e, F)
        smallest = min(smallest, _determinant(F))
    return smallest


@njit(**COMPILE)
def assemble(
    x: FloatArray,
    tets: IntArray,
    gradients: FloatArray,
    volumes: FloatArray,
    mu: FloatArray,
    eta: FloatArray,
    kappa: FloatArray,
    plain: bool,
    fibre: FloatArray,
    tension_only: bool,
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
    """
    F = np.empty((3, 3))
    H = np.empty((3, 3))
    g = np.empty((4, 3))
    f = np.empty((4, 3))
    h = np.empty((4, 3))
    z = np.empty(4)
    w = np.empty(3)
    for e in range(tets.shape[0]):
        _deformation_gradient(x, tets, gradients, e, F)
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
        I1 = 0.0
        I4 = 0.0
        for i in range(3):
            for j in range(3):
                H[i, j] *= r
                I1 += F[i, j] * F[i, j]
            w[i] = F[i, 0] * fibre[0] + F[i, 1] * fibre[1] + F[i, 2] * fibre[2]
            I4 += w[i] * w[i]
        for j in range(3):
            g[1, j] = gradients[e, 0, j]
            g[2, j] = gradients[e, 1, j]
            g[3, j] = gradients[e, 2, j]
            g[0, j] = -(g[1, j] + g[2, j] + g[3, j])
        for a in range(4):
            z[a] = g[a, 0] * fibre[0] + g[a, 1] * fibre[1] + g[a, 2] * fibre[2]
            for i in range(3):
                f[a, i] = F[i, 0] * g[a, 0] + F[i, 1] * g[a, 1] + F[i, 2] * g[a, 2]
                h[a, i] = H[i, 0] * g[a, 0] + H[i, 1] * g[a, 1] + H[i, 2] * g[a, 2]

        v = volumes[e]
        phi0, phi1, phi2 = _isochoric_factor(J)
        m0 = mu[e] * v * phi0
        m1 = mu[e] * v * phi1
        m2 = mu[e] * v * phi2
        p = 0.25 * (
            pressure[tets[e, 0]]
            + pressure[tets[e, 1]]
            + pressure[tets[e, 2]]
            + pressure[tets[e, 3]]
        )
        stiffening = 0.0
        if plain:
            p = kappa[e] * (J - 1.0)
            stiffening = kappa[e] * J * J * v
        pJ = p * J * v
        c2 = 2.0 * eta[e] * v * (I4 - 1.0)
        c4 = 4.0 * eta[e] * v
        if tension_only and I4 < 1.0:
            c2 = 0.0
            c4 = 0.0
        hh = 0.5 * m1 * I1 + pJ
        for a in range(4):
            n = tets[e, a]
            for i in range(3):
                force[n, i] += m0 * f[a, i] + hh * h[a, i] + c2 * z[a] * w[i]

        if convex:
            c2 = max(c2, 0.0)
            pJ = 0.0
        straight = 0.5 * I1 * (m1 + m2) + pJ + stiffening
        crossed = -0.5 * m1 * I1 - pJ
        share = 0.25 * J * v
        for a in range(3):
            for b in range(a + 1, 4):
                gg = g[a, 0] * g[b, 0] + g[a, 1] * g[b, 1] + g[a, 2] * g[b, 2]
                zz = z[a] * z[b]
                diagonal = m0 * gg + c2 * zz
                fibre_part = c4 * zz
                upper = edge[e, a, b]
                lower = edge[e, b, a]
                here = edge[e, a, a]
                there = edge[e, b, b]
                for i in range(3):
                    left = straight * h[a, i] + m1 * f[a, i]
                    mixed = m1 * h[a, i]
                    turned = crossed * h[b, i]
                    along = fibre_part * w[i]
                    for k in range(3):
                        value = left * h[b, k] + mixed * f[b, k] + turned * h[a, k] + along * w[k]
                        if i == k:
                            value += diagonal
                        K[upper, 3 * i + k] += value
                        K[lower, 3 * k + i] += value
                        # Rigid translations cost nothing: rows of the element sum to zero.
                        K[here, 3 * i + k] -= value
                        K[there, 3 * k + i] -= value
        for a in range(4):
            s0 = share * h[a, 0]
            s1 = share * h[a, 1]
            s2 = share * h[a, 2]
            for b in range(4):
                q = edge[e, a, b]
                B[q, 0] += s0
                B[q, 1] += s1
                B[q, 2] += s2
