r"""Skin as an incompressible neo-Hookean sheet on the surface triangles.

With the metric g of the deformed triangle and G of the undeformed one,

.. math:: W = \tfrac{\mu t A}{2} (\mathrm{tr}\, G^{-1} g + \det G / \det g - 3),

the plane-stress form of the incompressible law with shear modulus mu = E / 3
(Bonet & Wood 2008, section 6.6). It has no bending stiffness.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from storage.values import FloatArray, IntArray
from workers.fem.kernels import COMPILE, Float32Array


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
        """What the kernels take."""
        return self.triangles, self.metric, self.area


def sheet_of(nodes: FloatArray, triangles: IntArray) -> Sheet:
    """The undeformed sheet on `triangles`, shape (k, 3)."""
    e1 = nodes[triangles[:, 1]] - nodes[triangles[:, 0]]
    e2 = nodes[triangles[:, 2]] - nodes[triangles[:, 0]]
    g11, g12, g22 = ((a * b).sum(axis=1) for a, b in ((e1, e1), (e1, e2), (e2, e2)))
    det = g11 * g22 - g12**2
    metric = np.stack([g22, -g12, g11], axis=1) / det[:, None]
    return Sheet(triangles, metric, 0.5 * np.sqrt(det))


@njit(inline="always", **COMPILE)
def _edges(x: FloatArray, triangles: IntArray, t: int, e: FloatArray) -> None:
    for i in range(3):
        o = x[triangles[t, 0], i]
        e[0, i] = x[triangles[t, 1], i] - o
        e[1, i] = x[triangles[t, 2], i] - o


@njit(**COMPILE)
def sheet_energy(
    x: FloatArray, triangles: IntArray, metric: FloatArray, area: FloatArray, stiffness: float
) -> float:
    """Energy in mJ; `stiffness` is mu t in N/mm."""
    e = np.empty((2, 3))
    total = 0.0
    for t in range(triangles.shape[0]):
        _edges(x, triangles, t, e)
        g11 = e[0, 0] * e[0, 0] + e[0, 1] * e[0, 1] + e[0, 2] * e[0, 2]
        g12 = e[0, 0] * e[1, 0] + e[0, 1] * e[1, 1] + e[0, 2] * e[1, 2]
        g22 = e[1, 0] * e[1, 0] + e[1, 1] * e[1, 1] + e[1, 2] * e[1, 2]
        trace = metric[t, 0] * g11 + 2.0 * metric[t, 1] * g12 + metric[t, 2] * g22
        det = (g11 * g22 - g12 * g12) * (metric[t, 0] * metric[t, 2] - metric[t, 1] ** 2)
        total += 0.5 * stiffness * area[t] * (trace + 1.0 / det - 3.0)
    return total


@njit(**COMPILE)
def sheet_assemble(
    x: FloatArray,
    triangles: IntArray,
    metric: FloatArray,
    area: FloatArray,
    stiffness: float,
    edge: IntArray,
    force: FloatArray,
    K: Float32Array,
) -> None:
    """Add the sheet's force, (n, 3) in N, and tangent to K, (edges, 9).

    `edge`, (k, 3, 3), is the row of K of each pair of corners. With an empty K the
    force alone is added.
    """
    e = np.empty((2, 3))
    dual = np.empty((2, 3))
    S = np.empty((2, 2))
    inv = np.empty((2, 2))
    M = np.empty((2, 2, 3, 3))
    for t in range(triangles.shape[0]):
        _edges(x, triangles, t, e)
        g11 = e[0, 0] * e[0, 0] + e[0, 1] * e[0, 1] + e[0, 2] * e[0, 2]
        g12 = e[0, 0] * e[1, 0] + e[0, 1] * e[1, 1] + e[0, 2] * e[1, 2]
        g22 = e[1, 0] * e[1, 0] + e[1, 1] * e[1, 1] + e[1, 2] * e[1, 2]
        det_g = g11 * g22 - g12 * g12
        det = det_g * (metric[t, 0] * metric[t, 2] - metric[t, 1] ** 2)
        scale = stiffness * area[t]
        c = scale / det
        inv[0, 0] = g22 / det_g
        inv[0, 1] = -g12 / det_g
        inv[1, 0] = inv[0, 1]
        inv[1, 1] = g11 / det_g
        S[0, 0] = scale * metric[t, 0] - c * inv[0, 0]
        S[0, 1] = scale * metric[t, 1] - c * inv[0, 1]
        S[1, 0] = S[0, 1]
        S[1, 1] = scale * metric[t, 2] - c * inv[1, 1]
        for i in range(3):
            dual[0, i] = inv[0, 0] * e[0, i] + inv[0, 1] * e[1, i]
            dual[1, i] = inv[1, 0] * e[0, i] + inv[1, 1] * e[1, i]
            f1 = S[0, 0] * e[0, i] + S[0, 1] * e[1, i]
            f2 = S[1, 0] * e[0, i] + S[1, 1] * e[1, i]
            force[triangles[t, 0], i] -= f1 + f2
            force[triangles[t, 1], i] += f1
            force[triangles[t, 2], i] += f2
        if K.shape[0] == 0:
            continue
        for a in range(2):
            for b in range(2):
                for i in range(3):
                    for k in range(3):
                        plane = dual[0, i] * e[0, k] + dual[1, i] * e[1, k]
                        value = c * (
                            inv[a, b] * plane
                            + dual[b, i] * dual[a, k]
                            + 2.0 * dual[a, i] * dual[b, k]
                        )
                        if i == k:
                            value += S[a, b]
                        M[a, b, i, k] = value
        for i in range(3):
            for k in range(3):
                s = 3 * i + k
                for a in range(2):
                    for b in range(2):
                        v = M[a, b, i, k]
                        K[edge[t, a + 1, b + 1], s] += v
                        K[edge[t, 0, b + 1], s] -= v
                        K[edge[t, a + 1, 0], s] -= v
                        K[edge[t, 0, 0], s] += v
