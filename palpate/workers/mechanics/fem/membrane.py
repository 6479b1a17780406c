r"""Skin as a sheet on the surface triangles, which resists stretching and may wrinkle.

A sheet without bending stiffness cannot be compressed: it folds, finer than any
mesh, until nothing is compressed. It then stores the relaxed energy of
Pipkin (1986), *The relaxed energy density for isotropic elastic membranes*, IMA J.
Appl. Math. 36:85-99, the tension field of Steigmann (1990), *Tension-field theory*,
Proc. R. Soc. Lond. A 429:141-173. With the principal stretches l1 >= l2, shear modulus
mu = E / 3, thickness t and undeformed area A,

.. math::

    \frac{2 W}{\mu t A} = \begin{cases}
      l_1^2 + l_2^2 + (l_1 l_2)^{-2} - 3 & l_2 \ge l_1^{-1/2}        \text{: taut} \\
      l_1^2 + 2 / l_1 - 3        & l_2 < l_1^{-1/2},\ l_1 > 1 \text{: wrinkled along } l_1 \\
      0                          & l_1 \le 1                         \text{: slack.}
    \end{cases}

The first line is the incompressible neo-Hookean law in plane stress (Bonet & Wood
2008, section 6.6). At its border l2 is the natural width of a strip pulled along l1,
and the second line is the energy of that strip. W is once continuously
differentiable. It is convex in the positions of the nodes, being convex in (l1, l2)
and increasing in each of them: the tangent is never indefinite, whatever the regime.

The stretches come from the metrics: l1^2 and l2^2 are the eigenvalues of G^-1 g, with
g the metric of the deformed and G the metric of the undeformed triangle. In these
terms the taut sheet stores tr G^-1 g + det G / det g - 3.

Without `wrinkles` the sheet is taut everywhere, and pushes back when compressed.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.kernels_and_threads import CONTRACTED, Float32Array

TAUT, WRINKLED, SLACK = 0, 1, 2
# A sheet at rest is where the three regimes meet. To exclude rounding errors, it counts as taut.
_AT_REST = 1.0 - 1e-12


@dataclass(frozen=True, eq=False)
class Sheet:
    """Surface triangles with their undeformed metric.

    Parameters
    ----------
    triangles : ndarray of int32, shape (k, 3)
    metric : ndarray, shape (k, 3)
        G^-1 as (11, 12, 22), in 1/mm^2.
    area : ndarray, shape (k,)
    """

    triangles: IntArray
    metric: FloatArray
    area: FloatArray

    @property
    def arrays(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Triangles, metric and area, in the kernels' layout."""
        return self.triangles, self.metric, self.area


def sheet_of(nodes: FloatArray, triangles: IntArray) -> Sheet:
    """Return the undeformed sheet on `triangles`, shape (k, 3)."""
    e1 = nodes[triangles[:, 1]] - nodes[triangles[:, 0]]
    e2 = nodes[triangles[:, 2]] - nodes[triangles[:, 0]]
    g11, g12, g22 = ((a * b).sum(axis=1) for a, b in ((e1, e1), (e1, e2), (e2, e2)))
    det = g11 * g22 - g12**2
    metric = np.stack([g22, -g12, g11], axis=1) / det[:, None]
    return Sheet(triangles, metric, 0.5 * np.sqrt(det))


@njit(inline="always", **CONTRACTED)
def _edges(x: FloatArray, triangles: IntArray, t: int, e: FloatArray) -> None:
    """Set `e`, (2, 3), to two edges of triangle `t`."""
    for i in range(3):
        o = x[triangles[t, 0], i]
        e[0, i] = x[triangles[t, 1], i] - o
        e[1, i] = x[triangles[t, 2], i] - o


@njit(inline="always", **CONTRACTED)
def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**CONTRACTED)
def _principal(e: FloatArray, metric: FloatArray, n: FloatArray) -> tuple[float, float]:
    """Return l1^2 and l2^2; `n` receives their directions, (2, 2), as sums of undeformed edges.

    Where l1 = l2 there are none, and `n` may be nan; there are no wrinkles there.
    """
    # r r^T = G^-1: columns of r are orthonormal in the undeformed triangle.
    r11 = np.sqrt(metric[0])
    r21 = metric[1] / r11
    r22 = np.sqrt(metric[2] - r21 * r21)
    g11, g12, g22 = _dot(e[0], e[0]), _dot(e[0], e[1]), _dot(e[1], e[1])
    c11 = r11 * r11 * g11 + 2.0 * r11 * r21 * g12 + r21 * r21 * g22
    c12 = r22 * (r11 * g12 + r21 * g22)
    c22 = r22 * r22 * g22
    half = 0.5 * (c11 - c22)
    radius = np.sqrt(half * half + c12 * c12)
    # The longer of two parallel eigenvectors: free of cancellation.
    p, q = (half + radius, c12) if half >= 0.0 else (c12, radius - half)
    length = np.sqrt(p * p + q * q)
    p, q = p / length, q / length
    n[0, 0], n[0, 1] = p * r11, p * r21 + q * r22
    n[1, 0], n[1, 1] = -q * r11, p * r22 - q * r21
    mean = 0.5 * (c11 + c22)
    return mean + radius, mean - radius


@njit(inline="always", **CONTRACTED)
def _regime(c1: float, c2: float, wrinkles: bool) -> int:
    """Choose taut, wrinkled or slack from c1 = l1^2 and c2 = l2^2."""
    if not wrinkles or c2 * np.sqrt(c1) >= _AT_REST:
        return TAUT
    return WRINKLED if c1 > 1.0 else SLACK


@njit(**CONTRACTED)
def sheet_energy(
    x: FloatArray,
    triangles: IntArray,
    metric: FloatArray,
    area: FloatArray,
    stiffness: float,
    wrinkles: bool,
) -> float:
    """Return the energy in mJ; `stiffness` is mu t in N/mm."""
    e = np.empty((2, 3))
    n = np.empty((2, 2))
    total = 0.0
    for t in range(triangles.shape[0]):
        _edges(x, triangles, t, e)
        c1, c2 = _principal(e, metric[t], n)
        regime = _regime(c1, c2, wrinkles)
        if regime == TAUT:
            total += 0.5 * stiffness * area[t] * (c1 + c2 + 1.0 / (c1 * c2) - 3.0)
        elif regime == WRINKLED:
            total += 0.5 * stiffness * area[t] * (c1 + 2.0 / np.sqrt(c1) - 3.0)
    return total


@njit(**CONTRACTED)
def sheet_assemble(
    x: FloatArray,
    triangles: IntArray,
    metric: FloatArray,
    area: FloatArray,
    stiffness: float,
    wrinkles: bool,
    edge: IntArray,
    force: FloatArray,
    K: Float32Array,
) -> None:
    """Add the sheet's force, (n, 3) in N, and tangent to K, (edges, 9).

    `edge`, (k, 3, 3), is the row of K of each pair of corners. With an empty K only the
    force is added.
    """
    e = np.empty((2, 3))
    n = np.empty((2, 2))
    S = np.empty((2, 2))
    M = np.empty((2, 2, 3, 3))
    tangent = K.shape[0] > 0
    for t in range(triangles.shape[0]):
        _edges(x, triangles, t, e)
        c1, c2 = _principal(e, metric[t], n)
        regime = _regime(c1, c2, wrinkles)
        scale = stiffness * area[t]
        if regime == SLACK:
            continue
        if regime == TAUT:
            _taut(e, metric[t], scale, S, M, tangent)
        else:
            _wrinkled(e, n, c1, c2, scale, S, M, tangent)
        for i in range(3):
            f1 = S[0, 0] * e[0, i] + S[0, 1] * e[1, i]
            f2 = S[1, 0] * e[0, i] + S[1, 1] * e[1, i]
            force[triangles[t, 0], i] -= f1 + f2
            force[triangles[t, 1], i] += f1
            force[triangles[t, 2], i] += f2
        if tangent:
            _scatter(M, edge[t], K)


@njit(**CONTRACTED)
def _taut(
    e: FloatArray, metric: FloatArray, scale: float, S: FloatArray, M: FloatArray, tangent: bool
) -> None:
    """Set S = 2 dW/dg, so that S e are the forces on edges `e`, and M their derivative."""
    dual = np.empty((2, 3))
    inv = np.empty((2, 2))
    g11, g12, g22 = _dot(e[0], e[0]), _dot(e[0], e[1]), _dot(e[1], e[1])
    det_g = g11 * g22 - g12 * g12
    c = scale / (det_g * (metric[0] * metric[2] - metric[1] ** 2))
    inv[0, 0] = g22 / det_g
    inv[0, 1] = inv[1, 0] = -g12 / det_g
    inv[1, 1] = g11 / det_g
    S[0, 0] = scale * metric[0] - c * inv[0, 0]
    S[0, 1] = S[1, 0] = scale * metric[1] - c * inv[0, 1]
    S[1, 1] = scale * metric[2] - c * inv[1, 1]
    if not tangent:
        return
    for i in range(3):
        dual[0, i] = inv[0, 0] * e[0, i] + inv[0, 1] * e[1, i]
        dual[1, i] = inv[1, 0] * e[0, i] + inv[1, 1] * e[1, i]
    for a in range(2):
        for b in range(2):
            for i in range(3):
                for k in range(3):
                    plane = dual[0, i] * e[0, k] + dual[1, i] * e[1, k]
                    M[a, b, i, k] = c * (
                        inv[a, b] * plane + dual[b, i] * dual[a, k] + 2.0 * dual[a, i] * dual[b, k]
                    )
                M[a, b, i, i] += S[a, b]


@njit(**CONTRACTED)
def _wrinkled(
    e: FloatArray,
    n: FloatArray,
    c1: float,
    c2: float,
    scale: float,
    S: FloatArray,
    M: FloatArray,
    tangent: bool,
) -> None:
    """Set S and M of w(c1) with c1 = l1^2: tension along the wrinkles, none across.

    Wrinkles turn with the stretch. To first order ``d c1 = 2 n0 . f0 de`` and
    ``d n0 = n1 (n1 f0 + n0 f1) de / (c1 - c2)``, with fa the image of the direction na.
    """
    slope = 0.5 * scale * (1.0 - c1**-1.5)
    for a in range(2):
        for b in range(2):
            S[a, b] = 2.0 * slope * n[0, a] * n[0, b]
    if not tangent:
        return
    along = 3.0 * scale * c1**-2.5
    turning = 2.0 * slope / (c1 - c2)
    f = np.empty((2, 3))
    r = np.empty((2, 3))
    for i in range(3):
        f[0, i] = n[0, 0] * e[0, i] + n[0, 1] * e[1, i]
        f[1, i] = n[1, 0] * e[0, i] + n[1, 1] * e[1, i]
        r[0, i] = n[1, 0] * f[0, i] + n[0, 0] * f[1, i]
        r[1, i] = n[1, 1] * f[0, i] + n[0, 1] * f[1, i]
    for a in range(2):
        for b in range(2):
            stretched = along * n[0, a] * n[0, b]
            for i in range(3):
                for k in range(3):
                    M[a, b, i, k] = stretched * f[0, i] * f[0, k] + turning * r[a, i] * r[b, k]
                M[a, b, i, i] += S[a, b]


@njit(inline="always", **CONTRACTED)
def _scatter(M: FloatArray, edge: IntArray, K: Float32Array) -> None:
    """Add the stiffness of two edges, (2, 2, 3, 3), to the blocks of three corners."""
    for i in range(3):
        for k in range(3):
            s = 3 * i + k
            for a in range(2):
                for b in range(2):
                    v = M[a, b, i, k]
                    K[edge[a + 1, b + 1], s] += v
                    K[edge[0, b + 1], s] -= v
                    K[edge[a + 1, 0], s] -= v
                    K[edge[0, 0], s] += v
