"""Elements with any law of `workers.mechanics.materials`; slower than the compiled kernels."""

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.compile_flags import CONTRACTED
from palpate.workers.mechanics.fem.elements.element_constants import LawElements
from palpate.workers.mechanics.fem.elements.element_energy import Elements, deformation_gradients
from palpate.workers.mechanics.fem.problem.array_types import Float32Array


def law_energy(x: FloatArray, elements: Elements, part: LawElements) -> float:
    """Return the energy of the matrix of these elements in mJ; nan where one is inverted."""
    chosen = _restricted(elements, part)
    density = part.law.energy(deformation_gradients(x, chosen))
    return float((chosen.volumes * part.weight) @ density)


def law_assemble(
    x: FloatArray,
    elements: Elements,
    part: LawElements,
    edge: IntArray,
    force: FloatArray,
    K: Float32Array,
) -> None:
    """Add force, (n, 3) in N, and tangent to K, (edges, 9), unless it is empty."""
    chosen = _restricted(elements, part)
    F = deformation_gradients(x, chosen)
    weight = chosen.volumes * part.weight
    P = part.law.stress(F) * weight[:, None, None]
    A = np.empty((0, 3, 3, 3, 3))
    if len(K):
        A = part.law.tangent(F) * weight[:, None, None, None, None]
    _integrate(chosen.tets, chosen.gradients, P, A, edge[part.elements], force, K)


def _restricted(elements: Elements, part: LawElements) -> Elements:
    """Return only the elements of one law."""
    e = part.elements
    return Elements(elements.tets[e], elements.gradients[e], elements.volumes[e])


@njit(**CONTRACTED)
def _integrate(
    tets: IntArray,
    gradients: FloatArray,
    P: FloatArray,
    A: FloatArray,
    edge: IntArray,
    force: FloatArray,
    K: Float32Array,
) -> None:
    """Add the force of stresses P, (m, 3, 3), and the tangent of moduli A, (m, 3, 3, 3, 3)."""
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
