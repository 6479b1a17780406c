r"""Barrier against the collapse of elements, which the nodal average alone would permit.

Below :math:`J_b`, half of the volume at rest, each element stores

.. math:: W_b = 100 \mu \, (1 - J / J_b)^3 ,

with mu the shear modulus at rest, whatever the law. It is twice continuously differentiable, and
zero where no element loses half of its volume. With :math:`C_a = \mathrm{cof}(F) \, g_a`, the
gradient of J in the position of node a, its force is :math:`V W_b' C_a` and its tangent
:math:`V (W_b'' C_a \otimes C_b - W_b' [F (g_a \times g_b)]_\times)`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.compile_flags import CONTRACTED
from palpate.workers.mechanics.fem.elements.element_constants import growth_of, shear_moduli_mpa
from palpate.workers.mechanics.fem.elements.element_energy import (
    Elements,
    deformation_gradients,
    volume_ratios,
)
from palpate.workers.mechanics.fem.elements.model import LevelModel
from palpate.workers.mechanics.fem.problem.array_types import Float32Array
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem

# Volume ratio at which the barrier begins, and ratio of its stiffness to the shear modulus.
J_BARRIER = 0.5
STIFFNESS = 100.0


class Barrier(NamedTuple):
    """Barrier of all elements.

    Parameters
    ----------
    stiffness_mpa : ndarray, shape (m,)
        100 mu.
    j : float
        Volume ratio at which it begins.
    """

    stiffness_mpa: FloatArray
    j: float


def barrier_of(model: LevelModel, problem: Problem) -> Barrier:
    """Return the barrier of a mesh; in shrunken tissue it begins below the tissue's own volume."""
    j = J_BARRIER * min(1.0, float(growth_of(problem, model.fractions).min()))
    return Barrier(STIFFNESS * shear_moduli_mpa(model, problem), j)


def barrier_energy(x: FloatArray, elements: Elements, barrier: Barrier) -> float:
    """Return the energy of the barrier in mJ."""
    J = volume_ratios(x, elements)
    closed = np.maximum(1 - J / barrier.j, 0.0)
    return float((elements.volumes * barrier.stiffness_mpa) @ closed**3)


def barrier_stress_mpa(J: FloatArray, barrier: Barrier) -> FloatArray:
    """Return dW_b/dJ of each element, shape (m,): zero or negative."""
    closed = np.maximum(1 - J / barrier.j, 0.0)
    return np.asarray(-3 / barrier.j * barrier.stiffness_mpa * closed**2)


@njit(**CONTRACTED)
def barrier_assemble(
    x: FloatArray,
    elements: Elements,
    barrier: Barrier,
    edge: IntArray,
    convex: bool,
    force: FloatArray,
    K: Float32Array,
) -> None:
    """Add force, (n, 3) in N, and tangent to K, (edges, 9), unless it is empty.

    `convex` omits the geometric stiffness, which may be negative.
    """
    tets = elements.tets
    F, C = deformation_gradients(x, elements), np.empty((3, 3))
    g, c = np.empty((4, 3)), np.empty((4, 3))
    for e in range(tets.shape[0]):
        for i in range(3):
            p, q = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                r, s = (j + 1) % 3, (j + 2) % 3
                C[i, j] = F[e, p, r] * F[e, q, s] - F[e, p, s] * F[e, q, r]
        J = F[e, 0, 0] * C[0, 0] + F[e, 0, 1] * C[0, 1] + F[e, 0, 2] * C[0, 2]
        closed = 1.0 - J / barrier.j
        if closed <= 0.0:
            continue
        rate = 3.0 / barrier.j * elements.volumes[e] * barrier.stiffness_mpa[e] * closed
        first, second = -rate * closed, 2.0 / barrier.j * rate
        for j in range(3):
            g[1, j] = elements.gradients[e, 0, j]
            g[2, j] = elements.gradients[e, 1, j]
            g[3, j] = elements.gradients[e, 2, j]
            g[0, j] = -(g[1, j] + g[2, j] + g[3, j])
        for a in range(4):
            for i in range(3):
                c[a, i] = C[i, 0] * g[a, 0] + C[i, 1] * g[a, 1] + C[i, 2] * g[a, 2]
                force[tets[e, a], i] += first * c[a, i]
        if K.shape[0] == 0:
            continue
        for a in range(4):
            for b in range(4):
                for i in range(3):
                    for k in range(3):
                        K[edge[e, a, b], 3 * i + k] += second * c[a, i] * c[b, k]
                if convex or a == b:
                    continue
                for k in range(3):
                    w = 0.0
                    for j in range(3):
                        r, s = (j + 1) % 3, (j + 2) % 3
                        w += F[e, k, j] * (g[a, r] * g[b, s] - g[a, s] * g[b, r])
                    # -[w]_x has w_k at (i, j) and -w_k at (j, i), in cyclic order.
                    i, j = (k + 1) % 3, (k + 2) % 3
                    K[edge[e, a, b], 3 * i + j] += first * w
                    K[edge[e, a, b], 3 * j + i] -= first * w
