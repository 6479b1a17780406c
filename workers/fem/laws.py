"""Elements whose matrix follows a law of `workers.materials`: slower than the kernels, any law."""

import numpy as np
from numba import njit

from storage.values import FloatArray, IntArray
from workers.fem.composition import LawShare
from workers.fem.kernels import COMPILE, Elements, Float32Array, deformation_gradients


def law_energy(x: FloatArray, elements: Elements, share: LawShare) -> float:
    """Energy of the matrix of these elements in mJ; nan where one is inverted."""
    part = _part(elements, share)
    density = share.law.energy(deformation_gradients(x, part))
    return float((part.volumes * share.weight) @ density)


def law_assemble(
    x: FloatArray,
    elements: Elements,
    share: LawShare,
    edge: IntArray,
    force: FloatArray,
    K: Float32Array,
) -> None:
    """Add force, (n, 3) in N, and tangent to K, (edges, 9), unless it is empty."""
    part = _part(elements, share)
    F = deformation_gradients(x, part)
    weight = part.volumes * share.weight
    P = share.law.stress(F) * weight[:, None, None]
    A = np.empty((0, 3, 3, 3, 3))
    if len(K):
        A = share.law.tangent(F) * weight[:, None, None, None, None]
    _integrate(part.tets, part.gradients, P, A, edge[share.elements], force, K)


def _part(elements: Elements, share: LawShare) -> Elements:
    e = share.elements
    return Elements(elements.tets[e], elements.gradients[e], elements.volumes[e])


@njit(**COMPILE)
def _integrate(
    tets: IntArray,
    gradients: FloatArray,
    P: FloatArray,
    A: FloatArray,
    edge: IntArray,
    force: FloatArray,
    K: Float32Array,
) -> None:
    g = np.empty((4, 3))
    for e in range(tets.shape[0]):
        for j in range(3):
            g[1, j] = gradients[e, 0, j]
            g[2, j] = gradients[e, 1, j]
            g[3, j] = gradients[e, 2, j]
            g[0, j] = -(g[1, j] + g[2, j] + g[3, j])
        for a in range(4):
            for i in range(3):
                for j in range(3):
                    force[tets[e, a], i] += P[e, i, j] * g[a, j]
        if A.shape[0] == 0:
            continue
        for a in range(4):
            for b in range(4):
                for i in range(3):
                    for k in range(3):
                        value = 0.0
                        for j in range(3):
                            for m in range(3):
                                value += g[a, j] * A[e, i, j, k, m] * g[b, m]
                        K[edge[e, a, b], 3 * i + k] += value
