r"""Energy of a body made of linear tetrahedra.

Each element has an isochoric matrix, neo-Hookean or Yeoh, and up to two families of
fibres,

.. math:: W_e = \tfrac{\mu}{2}(\bar I_1 - 3) + c_2 (\bar I_1 - 3)^2
          + \sum_f \tfrac{\eta_f}{2}(I_{4f} - 1)^2 , \quad \bar I_1 = J^{-2/3} I_1 ,

and each node has a volume ratio, averaged over the elements around it, that stores

.. math:: W_n = \tfrac{\kappa_n}{2} (v_n / V_n - \gamma_n)^2 .

:math:`\gamma_n` is 1 where nothing has grown, see `mechanics.fem.elements.element_constants`. The
nodal average (Bonet & Burton 1998) keeps linear tetrahedra from locking at
nu = 0.49. `mechanics.fem.elements.assembly` has the first and second derivatives. The second
is the sum of 3 x 3 blocks over the edges of the mesh and a rank-one term per
node, ``sum_n (kappa_n / V_n) g_n g_n^T`` with ``g_n = d v_n / d u``, stored separately
because assembling it would couple nodes two edges away.

A fibre may be measured by :math:`\bar I_4 = J^{-2/3} I_4` instead. All these terms are
functions of an invariant :math:`\varphi(J)\, F A : F` (A = 1, or the dyad of the fibre),
so one set of derivatives serves them all.

With `plain` set, each element stores its own ``kappa/2 (J - 1)^2`` instead: the textbook
linear tetrahedron, which locks and serves for comparison.

Below J = 0.2 the factor :math:`J^{-2/3}` continues as a parabola, twice
continuously differentiable, so that a trial step may invert an element.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.kernels_and_threads import CONTRACTED

# The factor and its first two derivatives where the parabola begins.
J_SMALL = 0.2
PHI0 = J_SMALL ** (-2.0 / 3.0)
PHI1 = -2.0 / 3.0 * PHI0 / J_SMALL
PHI2 = 10.0 / 9.0 * PHI0 / J_SMALL**2


class Elements(NamedTuple):
    """Tetrahedra, (m, 4), gradients of their last three shape functions, (m, 3, 3), volumes."""

    tets: IntArray
    gradients: FloatArray
    volumes: FloatArray


class ElementMaterial(NamedTuple):
    """Constants of the elements in the kernels' layout.

    Parameters
    ----------
    mu, c2, kappa : ndarray, shape (m,)
        MPa.
    eta : ndarray, shape (m, families), and fibre : ndarray, shape (m, families, 3)
        Stiffness in MPa and direction of the fibres.
    tension_only, isochoric_fibre, plain : bool
        See `workers.mechanics.fem.boundary_value_problem.Problem`.
    """

    mu: FloatArray
    c2: FloatArray
    kappa: FloatArray
    eta: FloatArray
    fibre: FloatArray
    tension_only: bool
    isochoric_fibre: bool
    plain: bool


@njit(inline="always", **CONTRACTED)
def _isochoric_factor(J: float) -> float:
    """Return J^(-2/3)."""
    if J >= J_SMALL:
        c = 1.0 / np.cbrt(J)
        return c * c
    s = J - J_SMALL
    return PHI0 + PHI1 * s + 0.5 * PHI2 * s * s


@njit(**CONTRACTED)
def shape_gradients(nodes: FloatArray, tets: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return gradients of the last three shape functions, (m, 3, 3), and volumes, (m,).

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


@njit(inline="always", **CONTRACTED)
def _deformation_gradient(
    x: FloatArray, tets: IntArray, gradients: FloatArray, e: int, F: FloatArray
) -> None:
    """Set `F`, (3, 3), to the deformation gradient of element `e`."""
    n0, n1, n2, n3 = tets[e, 0], tets[e, 1], tets[e, 2], tets[e, 3]
    for i in range(3):
        o = x[n0, i]
        d1 = x[n1, i] - o
        d2 = x[n2, i] - o
        d3 = x[n3, i] - o
        for j in range(3):
            F[i, j] = d1 * gradients[e, 0, j] + d2 * gradients[e, 1, j] + d3 * gradients[e, 2, j]


@njit(inline="always", **CONTRACTED)
def _determinant(F: FloatArray) -> float:
    """Return the determinant of a 3 x 3 matrix."""
    return (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        + F[0, 1] * (F[1, 2] * F[2, 0] - F[1, 0] * F[2, 2])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


@njit(**CONTRACTED)
def deformation_gradients(x: FloatArray, elements: Elements) -> FloatArray:
    """Return F of each element, shape (m, 3, 3)."""
    F = np.empty((elements.tets.shape[0], 3, 3))
    for e in range(F.shape[0]):
        _deformation_gradient(x, elements.tets, elements.gradients, e, F[e])
    return F


@njit(**CONTRACTED)
def energy(
    x: FloatArray, elements: Elements, material: ElementMaterial, nodal_volumes: FloatArray
) -> float:
    """Return the energy of the elements in mJ; `nodal_volumes` receives v_n in mm^3."""
    tets, volumes, fibre = elements.tets, elements.volumes, material.fibre
    F = np.empty((3, 3))
    total = 0.0
    nodal_volumes[:] = 0.0
    for e in range(tets.shape[0]):
        _deformation_gradient(x, tets, elements.gradients, e, F)
        J = _determinant(F)
        I1 = 0.0
        for i in range(3):
            I1 += F[i, 0] * F[i, 0] + F[i, 1] * F[i, 1] + F[i, 2] * F[i, 2]
        phi = _isochoric_factor(J)
        s = phi * I1 - 3.0
        density = (0.5 * material.mu[e] + material.c2[e] * s) * s
        for q in range(fibre.shape[1]):
            I4 = 0.0
            for i in range(3):
                w = F[i, 0] * fibre[e, q, 0] + F[i, 1] * fibre[e, q, 1] + F[i, 2] * fibre[e, q, 2]
                I4 += w * w
            stretch = (phi * I4 if material.isochoric_fibre else I4) - 1.0
            if not (material.tension_only and stretch < 0.0):
                density += 0.5 * material.eta[e, q] * stretch * stretch
        if material.plain:
            density += 0.5 * material.kappa[e] * (J - 1.0) * (J - 1.0)
        v = volumes[e]
        total += v * density
        share = 0.25 * J * v
        for a in range(4):
            nodal_volumes[tets[e, a]] += share
    return total


@njit(**CONTRACTED)
def volume_ratios(x: FloatArray, elements: Elements) -> FloatArray:
    """Return J of each element, shape (m,)."""
    F, J = np.empty((3, 3)), np.empty(elements.tets.shape[0])
    for e in range(J.shape[0]):
        _deformation_gradient(x, elements.tets, elements.gradients, e, F)
        J[e] = _determinant(F)
    return J


@njit(**CONTRACTED)
def smallest_volume_ratio(x: FloatArray, elements: Elements) -> float:
    """Return the smallest J over the elements."""
    F = np.empty((3, 3))
    smallest = np.inf
    for e in range(elements.tets.shape[0]):
        _deformation_gradient(x, elements.tets, elements.gradients, e, F)
        smallest = min(smallest, _determinant(F))
    return smallest
