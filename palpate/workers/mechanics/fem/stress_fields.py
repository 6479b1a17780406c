r"""Stress, strain and volume change of a solution, per element and per node.

In the nodal-averaged element the first Piola-Kirchhoff stress is

.. math:: P = \frac{\partial W_e}{\partial F} + p\, J F^{-T}, \qquad
          p = \tfrac14 \sum_{a=1}^4 \kappa_a (v_a / V_a - \gamma_a) ,

the mean of the pressures of its four nodes, with :math:`\gamma = 1` where nothing has grown
(Bonet & Burton, Comm. Numer. Meth. Engng 14 (1998) 437-449): the force on a node is then the
sum of :math:`V P g_a` over the elements around it. In a plain element
:math:`p = \kappa (J - 1)`. The barrier of elements adds to p where it acts, see
`mechanics.fem.elements.barrier`. Here p is positive in tension; the reported `pressure_mpa`
is positive in compression, like a fluid pressure.
"""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem import element_energy
from palpate.workers.mechanics.fem.element_energy import J_SMALL, PHI0, PHI1, PHI2
from palpate.workers.mechanics.fem.element_laws import barrier_stress_mpa
from palpate.workers.mechanics.fem.mesh_level import Level


@dataclass(frozen=True, eq=False)
class ElementFields:
    """Stress, strain and volume change of a solution; m elements, n nodes.

    Parameters
    ----------
    volume_ratio : ndarray, shape (m,)
        J of each element.
    green_strain : ndarray, shape (m, 3, 3)
        E = (F^T F - 1) / 2.
    piola_mpa, cauchy_mpa : ndarray, shape (m, 3, 3)
        First Piola-Kirchhoff stress P, and P F^T / J.
    pressure_mpa : ndarray, shape (m,)
        Minus a third of the trace of the Cauchy stress; positive in compression.
    node_volume_ratio, node_pressure_mpa : ndarray, shape (n,)
        Volume-weighted averages over the elements around a node.
    """

    volume_ratio: FloatArray
    green_strain: FloatArray
    piola_mpa: FloatArray
    cauchy_mpa: FloatArray
    pressure_mpa: FloatArray
    node_volume_ratio: FloatArray
    node_pressure_mpa: FloatArray

    @property
    def von_mises_mpa(self) -> FloatArray:
        """Return the von Mises stress of each element, shape (m,)."""
        deviator = self.cauchy_mpa + self.pressure_mpa[:, None, None] * np.eye(3)
        return np.sqrt(1.5 * np.einsum("eij,eij->e", deviator, deviator))


def element_fields(level: Level, x: FloatArray) -> ElementFields:
    """Return stress, strain and volume change at positions `x`, shape (n, 3) in mm.

    Skin is a separate sheet: its stress is not included in the elements' stress.
    """
    elements = level.model.elements
    F = element_energy.deformation_gradients(x, elements)
    J = np.linalg.det(F)
    P = _isochoric_stress(level, F, J) + _fibre_stress(level, F, J)
    cofactor = J[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    P += _mean_stress(level, J)[:, None, None] * cofactor
    cauchy = np.einsum("eij,ekj->eik", P, F) / J[:, None, None]
    pressure = -np.trace(cauchy, axis1=1, axis2=2) / 3
    return ElementFields(
        volume_ratio=J,
        green_strain=0.5 * (np.einsum("eki,ekj->eij", F, F) - np.eye(3)),
        piola_mpa=P,
        cauchy_mpa=cauchy,
        pressure_mpa=pressure,
        node_volume_ratio=_at_nodes(level, J),
        node_pressure_mpa=_at_nodes(level, pressure),
    )


def _at_nodes(level: Level, values: FloatArray) -> FloatArray:
    """Average element values, (m,), around each node, (n,), weighted by volume."""
    elements, total = level.model.elements, level.model.nodal_volumes
    share = np.repeat(elements.volumes * values / 4, 4)
    return np.asarray(np.bincount(elements.tets.ravel(), share, len(total)) / total)


def _mean_stress(level: Level, J: FloatArray) -> FloatArray:
    """Return p of each element, positive in tension, shape (m,) in MPa."""
    barrier = 0.0 if level.barrier is None else barrier_stress_mpa(J, level.barrier)
    if level.problem.plain_elements:
        return np.asarray(level.constants.material.kappa * (J - 1) + barrier)
    node = level.nodal_bulk_mpa * (_at_nodes(level, J) - level.constants.nodal_growth)
    return np.asarray(node[level.model.elements.tets].mean(axis=1) + barrier)


def _isochoric_stress(level: Level, F: FloatArray, J: FloatArray) -> FloatArray:
    """Return the matrix's contribution to P, shape (m, 3, 3)."""
    material = level.constants.material
    phi, slope = _isochoric_factor(J)
    s = phi * np.einsum("eij,eij->e", F, F) - 3
    P = _of_invariant(material.mu / 2 + 2 * material.c2 * s, F, F, phi, slope, J)
    for part in level.constants.laws:
        P[part.elements] += part.weight[:, None, None] * part.law.stress(F[part.elements])
    return P


def _fibre_stress(level: Level, F: FloatArray, J: FloatArray) -> FloatArray:
    """Return the fibres' contribution to P, shape (m, 3, 3)."""
    material = level.constants.material
    phi, slope = _isochoric_factor(J)
    if not material.isochoric_fibre:
        phi, slope = np.ones_like(J), np.zeros_like(J)
    P = np.zeros_like(F)
    for family in range(material.fibre.shape[1]):
        a = material.fibre[:, family]
        Fa = np.einsum("eij,ej->ei", F, a)
        stretch = phi * np.einsum("ei,ei->e", Fa, Fa) - 1
        if material.tension_only:
            stretch = np.maximum(stretch, 0.0)
        FA = Fa[:, :, None] * a[:, None, :]
        P += _of_invariant(material.eta[:, family] * stretch, FA, F, phi, slope, J)
    return P


def _of_invariant(
    rate: FloatArray,
    FA: FloatArray,
    F: FloatArray,
    phi: FloatArray,
    slope: FloatArray,
    J: FloatArray,
) -> FloatArray:
    """Return dW/dF of a W with dW/dy = `rate`, shape (m,), for y = ``phi(J) F A : F``."""
    invariant = np.einsum("eij,eij->e", FA, F)
    cofactor = J[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    straight = 2 * (rate * phi)[:, None, None] * FA
    return np.asarray(straight + (rate * slope * invariant)[:, None, None] * cofactor)


def _isochoric_factor(J: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return J^(-2/3) and its derivative, as `element_energy` continues it below `J_SMALL`."""
    large, s = np.maximum(J, J_SMALL), J - J_SMALL
    phi = np.where(J < J_SMALL, PHI0 + PHI1 * s + 0.5 * PHI2 * s * s, large ** (-2 / 3))
    slope = np.where(J < J_SMALL, PHI1 + PHI2 * s, -2 / 3 * large ** (-5 / 3))
    return phi, slope
