r"""Plane stress of any three-dimensional law in a sheet with unloaded faces.

The sheet has the metric :math:`C_{ab} = f_a \cdot f_b` of its deformed tangents. Its thickness
stretch :math:`\lambda` makes the stress across it vanish. With
:math:`F = \mathrm{diag}(R, \lambda)`, R the upper triangular root of C, and
:math:`W = W_{law}(F) + \tfrac{\kappa}{2} (J - 1)^2`,

.. math:: \partial W / \partial F_{33} = 0, \quad
          \mathbb{D}_{abcd} = \mathbb{C}_{abcd}
          - \mathbb{C}_{ab33} \mathbb{C}_{33cd} / \mathbb{C}_{3333}

(S. Klinkel and S. Govindjee, Eng. Comput. 19 (2002) 147-164), in the second Piola-Kirchhoff
stress S and the Green-Lagrange strain.
"""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.base import Law

MOST_ITERATIONS = 60
# Steps of the logarithm of the thickness stretch: the last one, after which the error is about
# its square, and the longest one.
SHORTEST, LONGEST = 1e-7, 0.5


@dataclass(frozen=True, eq=False)
class PlaneStress:
    """Response at q points of a sheet.

    Parameters
    ----------
    stress : ndarray, shape (q, 3)
        S11, S22 and S12 in MPa.
    tangent : ndarray, shape (q, 3, 3)
        Derivative of the stress with respect to E11, E22 and 2 E12, in MPa.
    thickness_stretch : ndarray, shape (q,)
    """

    stress: FloatArray
    tangent: FloatArray
    thickness_stretch: FloatArray


def plane_stress(
    C: FloatArray, law: Law, kappa_mpa: float, near: PlaneStress | None = None
) -> PlaneStress:
    """Return the response to a metric; nan where the metric is not positive definite.

    Parameters
    ----------
    C : ndarray, shape (q, 2, 2)
        Right Cauchy-Green tensor in the plane of the sheet.
    law : Law
        Law of the change of shape.
    kappa_mpa : float
        Bulk modulus, > 0.
    near : PlaneStress, optional
        Response of a similar material to the same metric; its thickness is the starting value.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        F = np.zeros((len(C), 3, 3))
        F[:, 0, 0] = np.sqrt(C[:, 0, 0])
        F[:, 0, 1] = C[:, 0, 1] / F[:, 0, 0]
        F[:, 1, 1] = np.sqrt(C[:, 1, 1] - F[:, 0, 1] ** 2)
        area = F[:, 0, 0] * F[:, 1, 1]
        start = 1 / area if near is None else near.thickness_stretch
        F[:, 2, 2] = _thickness_stretch(F, area, start, law, kappa_mpa)
        return _condensed(F, area, law, kappa_mpa)


def _thickness_stretch(
    F: FloatArray, area: FloatArray, start: FloatArray, law: Law, kappa_mpa: float
) -> FloatArray:
    """Return the thickness stretch for zero stress across the sheet, by Newton's method."""
    log = np.log(start)
    for _ in range(MOST_ITERATIONS):
        across = np.exp(log)
        F[:, 2, 2] = across
        P = law.stress(F)[:, 2, 2] + kappa_mpa * (area * across - 1) * area
        slope = law.tangent(F)[:, 2, 2, 2, 2] + kappa_mpa * area**2
        step = -P / np.maximum(across * slope + P, 1e-3 * across * slope)
        log = log + np.clip(step, -LONGEST, LONGEST)
        if not np.nanmax(np.abs(step), initial=0.0) > SHORTEST:
            break
    return np.exp(log)


def _condensed(F: FloatArray, area: FloatArray, law: Law, kappa_mpa: float) -> PlaneStress:
    across = F[:, 2, 2]
    J = area * across
    # J F^-T dJ: the upper triangular F is inverted by hand.
    inverse = np.zeros_like(F)
    inverse[:, 0, 0], inverse[:, 1, 1] = 1 / F[:, 0, 0], 1 / F[:, 1, 1]
    inverse[:, 2, 2] = 1 / across
    inverse[:, 0, 1] = -F[:, 0, 1] / area
    G = np.swapaxes(inverse, 1, 2)
    P = law.stress(F) + (kappa_mpa * (J - 1) * J)[:, None, None] * G
    A = law.tangent(F)
    A = A + np.einsum("q,qiJ,qkL->qiJkL", kappa_mpa * (2 * J - 1) * J, G, G)
    A -= np.einsum("q,qiL,qkJ->qiJkL", kappa_mpa * (J - 1) * J, G, G)
    S = inverse @ P
    A -= np.einsum("ik,qJL->qiJkL", np.eye(3), S)
    D = np.einsum("qMi,qNk,qiJkL->qMJNL", inverse, inverse, A, optimize=True)
    rows, columns = np.array([0, 1, 0]), np.array([0, 1, 1])
    plane = D[:, rows[:, None], columns[:, None], rows, columns]
    coupled = D[:, rows, columns, 2, 2]
    plane = plane - coupled[:, :, None] * coupled[:, None] / D[:, 2, 2, 2, 2][:, None, None]
    return PlaneStress(S[:, rows, columns], plane, across)
