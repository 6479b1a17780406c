r"""Stress and tangent of an Ogden law in plane stress, plane strain and axisymmetry.

For one term, with :math:`\bar\lambda_a = J^{-1/3} \lambda_a`,
:math:`q_a = \bar\lambda_a^{\alpha}`, their mean m, and the volumetric
:math:`h = J p(J)`, :math:`p = \sum_i K i (J - 1)^{2 i - 1}`,

.. math:: \tau_a = k (q_a - m) + h, \quad
          c_{ab} = \frac{\partial \tau_a}{\partial \ln \lambda_b}
          = k \alpha \left( \delta_{ab} q_a - \tfrac13 (q_a + q_b) + \tfrac13 m \right)
            + J p + J^2 p' .

The second Piola-Kirchhoff stress has the principal values
:math:`S_a = \tau_a / \lambda_a^2`, and its derivatives with respect to the strain are

.. math:: \frac{\partial S_a}{\partial E_b}
          = \frac{c_{ab} - 2 \tau_a \delta_{ab}}{\lambda_a^2 \lambda_b^2}, \quad
          g = \frac{S_1 - S_2}{\lambda_1^2 - \lambda_2^2}

along and across the principal directions. For equal stretches g is 0/0, so it is not
computed by that division: with :math:`x = \ln(\lambda_1 / \lambda_2)` and
:math:`\beta = \alpha / 2 - 1`,

.. math:: g = \frac{1}{\lambda_1^2 \lambda_2^2} \left( \sum k \left[ \sqrt{q_1 q_2}
          \frac{\sinh \beta x}{\sinh x} + m \right] - h \right) .

In plane stress the out-of-plane stretch makes :math:`\tau_3` vanish; its logarithm is found
by Halley's method and condensed,
:math:`c_{ab} - c_{a3} c_{3b} / c_{33}`.
"""

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray
from palpate.workers.kernels_and_threads import CONTRACTED
from palpate.workers.organs.cornea.corneal_model import OgdenLaw

# Two-dimensional kinds, as used in the kernels.
PLANE_STRESS, PLANE_STRAIN, AXISYMMETRIC = 0, 1, 2

# Halley's method for the thickness: the error after a step s is about (alpha s)^2 s / 10.
THICKNESS_TOLERANCE = 1e-6
MAX_THICKNESS_ITERATIONS = 30
LONGEST_LOG_STEP = 0.3
# Below this |beta x| three terms of sinh(beta x)/sinh(x) are exact to rounding.
SERIES_BELOW = 1e-2


@njit(inline="always", **CONTRACTED)
def _pressure(J: float, bulk: float, terms: int) -> tuple[float, float, float]:
    """Return ``h = J p`` of the volumetric energy and its first two derivatives in ln J."""
    d = J - 1.0
    power = 1.0  # (J - 1)^(2 i - 2)
    p, slope, curvature = bulk * d, bulk, 0.0
    for i in range(2, terms + 1):
        factor = bulk * i * (2 * i - 1)
        curvature += factor * (2 * i - 2) * power * d
        power *= d * d
        p += bulk * i * power * d
        slope += factor * power
    h, first = J * p, J * J * slope
    return h, h + first, h + 3.0 * first + J * J * J * curvature


@njit(inline="always", **CONTRACTED)
def _powers(e1: float, e2: float, e3: float, law: OgdenLaw, q: FloatArray) -> None:
    """Write ``lambda_bar_a ^ alpha_i`` for the logarithmic stretches into q, (N, 3)."""
    mean = (e1 + e2 + e3) / 3.0
    for i in range(len(law.exponent)):
        a = law.exponent[i]
        q[i, 0] = np.exp(a * (e1 - mean))
        q[i, 1] = np.exp(a * (e2 - mean))
        q[i, 2] = 1.0 / (q[i, 0] * q[i, 1])


@njit(**CONTRACTED)
def _without_stress_out_of_plane(
    e1: float, e2: float, law: OgdenLaw, stiffness: float, q: FloatArray
) -> float:
    """Return the volume ratio J at which the out-of-plane stress vanishes, and fill q.

    nan if Halley's method does not converge.
    """
    e3 = -law.plane_stress_ratio * (e1 + e2)
    terms = len(law.exponent)
    _powers(e1, e2, e3, law, q)
    J = np.exp(e1 + e2 + e3)
    for _ in range(MAX_THICKNESS_ITERATIONS):
        tau3, c33, curvature = _pressure(J, law.bulk_mpa, terms)
        for i in range(terms):
            k, a = stiffness * law.modulus_mpa[i], law.exponent[i]
            m = (q[i, 0] + q[i, 1] + q[i, 2]) / 3.0
            tau3 += k * (q[i, 2] - m)
            c33 += k * a * (q[i, 2] + m) / 3.0
            curvature += k * a * a * (q[i, 2] - m / 3.0) / 3.0
        if not c33 > 0.0:
            return np.nan
        newton = -tau3 / c33
        bend = max(1.0 + 0.5 * newton * curvature / c33, 0.5)
        step = min(max(newton / bend, -LONGEST_LOG_STEP), LONGEST_LOG_STEP)
        J *= np.exp(step)
        for i in range(terms):
            y = np.exp(law.exponent[i] * step / -3.0)
            q[i, 0] *= y
            q[i, 1] *= y
            q[i, 2] = 1.0 / (q[i, 0] * q[i, 1])
        if abs(step) < THICKNESS_TOLERANCE:
            return J
    return np.nan


@njit(inline="always", **CONTRACTED)
def _shear_term(
    beta: float, x: float, q1: float, q2: float, square1: float, square2: float, gap: float
) -> float:
    """Return ``sqrt(q1 q2) sinh(beta x) / sinh(x)``; gap is the difference of the squares."""
    if max(abs(beta), 1.0) * abs(x) < SERIES_BELOW:
        b2, x2 = beta * beta, x * x
        series = 1.0 + (b2 - 1.0) * x2 * (1.0 / 6.0 + (3.0 * b2 - 7.0) * x2 / 360.0)
        return np.sqrt(q1 * q2) * beta * series
    return (q1 * square2 - q2 * square1) / gap


@njit(**CONTRACTED)
def second_piola(
    c11: float,
    c22: float,
    c12: float,
    stretch3: float,
    law: OgdenLaw,
    stiffness: float,
    kind: int,
    with_tangent: bool,
    q: FloatArray,
    S: FloatArray,
    D: FloatArray,
) -> float:
    """Write the stress and, if requested, the tangent at one point, and return J.

    Parameters
    ----------
    c11, c22, c12 : float
        Right Cauchy-Green tensor in the plane.
    stretch3 : float
        Stretch around the axis; 1 in plane strain, not used in plane stress.
    law : OgdenLaw
    stiffness : float
        Factor of the moduli, not of the bulk modulus.
    kind : int
        PLANE_STRESS, PLANE_STRAIN or AXISYMMETRIC.
    with_tangent : bool
    q : ndarray, shape (N, 3)
        Scratch.
    S : ndarray, shape (4,)
        S11, S22, S12, S33 in MPa.
    D : ndarray, shape (4, 4)
        Derivative of S with respect to E11, E22, 2 E12 and E33, in MPa.
    """
    half = 0.5 * (c11 - c22)
    radius = np.sqrt(half * half + c12 * c12)
    square1 = 0.5 * (c11 + c22) + radius
    square2 = (c11 * c22 - c12 * c12) / square1
    e1, e2 = 0.5 * np.log(square1), 0.5 * np.log(square2)
    if kind == PLANE_STRESS:
        J = _without_stress_out_of_plane(e1, e2, law, stiffness, q)
    else:
        J = np.sqrt(square1 * square2) * stretch3
        _powers(e1, e2, np.log(stretch3) if kind == AXISYMMETRIC else 0.0, law, q)
    square3 = J * J / (square1 * square2)
    h, volumetric, _ = _pressure(J, law.bulk_mpa, len(law.exponent))
    t1, t2, t3 = h, h, h
    for i in range(len(law.exponent)):
        k = stiffness * law.modulus_mpa[i]
        m = (q[i, 0] + q[i, 1] + q[i, 2]) / 3.0
        t1 += k * (q[i, 0] - m)
        t2 += k * (q[i, 1] - m)
        t3 += k * (q[i, 2] - m)
    if kind == PLANE_STRESS:
        t3 = 0.0
    # Dyads of the principal directions in the order 11, 22, 12, from the double angle.
    cos2, sin2 = 1.0, 0.0
    if radius > 0.0:
        cos2, sin2 = half / radius, c12 / radius
    cc, ss, cs = 0.5 * (1.0 + cos2), 0.5 * (1.0 - cos2), 0.5 * sin2
    s1, s2 = t1 / square1, t2 / square2
    S[0] = s1 * cc + s2 * ss
    S[1] = s1 * ss + s2 * cc
    S[2] = (s1 - s2) * cs
    S[3] = t3 / square3
    if not with_tangent:
        return J
    k11, k22, k33 = volumetric, volumetric, volumetric
    k12, k13, k23 = volumetric, volumetric, volumetric
    shear = -h
    for i in range(len(law.exponent)):
        k, a = stiffness * law.modulus_mpa[i], law.exponent[i]
        q1, q2, q3 = q[i, 0], q[i, 1], q[i, 2]
        m = (q1 + q2 + q3) / 3.0
        slope = k * a / 3.0
        k11 += slope * (q1 + m)
        k22 += slope * (q2 + m)
        k33 += slope * (q3 + m)
        k12 += slope * (m - q1 - q2)
        k13 += slope * (m - q1 - q3)
        k23 += slope * (m - q2 - q3)
        term = _shear_term(0.5 * a - 1.0, e1 - e2, q1, q2, square1, square2, 2.0 * radius)
        shear += k * (term + m)
    if kind == PLANE_STRESS:
        k11 -= k13 * k13 / k33
        k22 -= k23 * k23 / k33
        k12 -= k13 * k23 / k33
    d11 = (k11 - 2.0 * t1) / (square1 * square1)
    d22 = (k22 - 2.0 * t2) / (square2 * square2)
    d12 = k12 / (square1 * square2)
    shear *= 4.0 / (square1 * square2)
    n1, n2, n12 = (cc, ss, cs), (ss, cc, -cs), (-cs, cs, 0.5 * cos2)
    for a in range(3):
        for b in range(a, 3):
            value = d11 * n1[a] * n1[b] + d22 * n2[a] * n2[b] + shear * n12[a] * n12[b]
            value += d12 * (n1[a] * n2[b] + n2[a] * n1[b])
            D[a, b] = value
            D[b, a] = value
    for a in range(4):
        D[a, 3] = 0.0
        D[3, a] = 0.0
    if kind == AXISYMMETRIC:
        d13, d23 = k13 / (square1 * square3), k23 / (square2 * square3)
        for a in range(3):
            D[a, 3] = d13 * n1[a] + d23 * n2[a]
            D[3, a] = D[a, 3]
        D[3, 3] = (k33 - 2.0 * t3) / (square3 * square3)
    return J
