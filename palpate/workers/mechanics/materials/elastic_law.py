r"""What an elastic law is, and what laws share: invariants, derivatives, checks, plane stress.

A law is a frozen value, independent of any mesh. Its methods take stacks of deformation
gradients and keep the leading axes, so the same code serves one point and a million.

An isochoric law depends only on the change of shape, ``Fbar = J^(-1/3) F``. The solver
adds the volumetric energy ``kappa/2 (J - 1)^2`` itself, because its evaluation, in each
element or averaged at nodes, is part of the discretisation.

From ``W(s F) = W(F)`` follow ``P(s F) = P(F) / s`` and ``A(s F) = A(F) / s^2``.
The laws here use this: they are evaluated at J = 1 and scaled.

Invariants of the change of shape and their derivatives are

.. math:: \bar I_1 = \operatorname{tr} \bar C, \quad
          \bar I_2 = \tfrac12 (\bar I_1^2 - \operatorname{tr} \bar C^2), \quad
          \bar C = J^{-2/3} F^T F .

The slopes and curvatures of a law :math:`W(\bar I_1, \bar I_2)` are converted to stress
and tangent. With :math:`F` scaled to J = 1, :math:`G = F^{-T}` and an
invariant I of degree d in F (2 or 4), the gradient of :math:`\bar I = J^{-d/3} I` is

.. math:: g = I' - \tfrac{d}{3} I G

and its second derivative, with :math:`\partial G_{iJ} / \partial F_{kL} = -G_{iL} G_{kJ}`,

.. math:: \bar I'' = I'' - \tfrac{d}{3} (g \otimes G + G \otimes g)
          - \tfrac{d^2}{9} I\, G \otimes G + \tfrac{d}{3} I\, G_{iL} G_{kJ} .

The outer products of a law are summed as one matrix product, ``V M V^T`` with
the vectors g1, g2, G, F in the columns of V.

`plane_stress` is that of any three-dimensional law in a sheet with unloaded faces. The sheet has
the metric :math:`C_{ab} = f_a \cdot f_b` of its deformed tangents. Its thickness
stretch :math:`\lambda` makes the stress across it vanish. With
:math:`F = \mathrm{diag}(R, \lambda)`, R the upper triangular root of C, and
:math:`W = W_{law}(F) + \tfrac{\kappa}{2} (J - 1)^2`,

.. math:: \partial W / \partial F_{33} = 0, \quad
          \mathbb{D}_{abcd} = \mathbb{C}_{abcd}
          - \mathbb{C}_{ab33} \mathbb{C}_{33cd} / \mathbb{C}_{3333}

in the second Piola-Kirchhoff stress S and the Green-Lagrange strain.

References
----------
G. A. Holzapfel, Nonlinear Solid Mechanics, Wiley 2000, sections 6.4 and 6.6.
S. Klinkel and S. Govindjee, Eng. Comput. 19 (2002) 147-164.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray


class Law(Protocol):
    """Hyperelastic law W(F)."""

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy per undeformed volume.

        Parameters
        ----------
        F : ndarray, shape (..., 3, 3)
            Deformation gradients.

        Returns
        -------
        ndarray, shape (...)
            In MPa (N mm / mm^3); zero at rest.
        """
        ...

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the first Piola-Kirchhoff stress dW/dF, shape (..., 3, 3), in MPa."""
        ...

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the second derivative d2W/dF2, shape (..., 3, 3, 3, 3) ordered iJkL, in MPa."""
        ...


class Isochoric(Law, Protocol):
    """Isotropic law of the change of shape, stress-free at rest.

    Where ``det F <= 0``, energy, stress and tangent are nan: no such body exists, and
    a line search backtracks from nan.
    """

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus mu0 at rest: for small strains ``P = 2 mu0 dev(eps)``."""
        ...


def require(
    name: str, law: object, positive: Mapping[str, float], finite: Iterable[float] = ()
) -> None:
    """Reject constants that do not describe an elastic body.

    Parameters
    ----------
    name : str
        Name of the law, as the beginning of a sentence.
    law : object
        Shown in the error message.
    positive : mapping of str to float
        Constants, or sums of them, that must be above zero.
    finite : iterable of float
        Constants that must be numbers.

    Raises
    ------
    InputError
        If a constant violates its condition.
    """
    if not all(math.isfinite(value) for value in (*positive.values(), *finite)):
        raise InputError(f"{name} needs constants that are finite numbers, got {law}.")
    if not all(value > 0 for value in positive.values()):
        values = ", ".join(f"{symbol} = {value:g}" for symbol, value in positive.items())
        raise InputError(
            f"{name} needs {' and '.join(positive)} above zero, got {values} from {law}. "
            "Check signs and units (MPa; 1 kPa is 0.001 MPa)."
        )


Scalar = FloatArray | float


@dataclass(frozen=True, eq=False)
class Shape:
    """Isochoric part of deformation gradients.

    Parameters
    ----------
    F : ndarray, shape (..., 3, 3)
        Scaled to det F = 1; nan where the original was not positive.
    G : ndarray, shape (..., 3, 3)
        Its inverse, transposed.
    scale : ndarray, shape (...)
        ``J^(-1/3)`` of the original: each derivative with respect to the original F
        contributes this factor once.
    """

    F: FloatArray
    G: FloatArray
    scale: FloatArray

    @cached_property
    def C(self) -> FloatArray:
        """Return the right Cauchy-Green tensor, shape (..., 3, 3)."""
        return np.swapaxes(self.F, -1, -2) @ self.F

    @cached_property
    def I1(self) -> FloatArray:
        """Return the first invariant, shape (...); 3 at rest."""
        return np.einsum("...iJ,...iJ->...", self.F, self.F)

    @cached_property
    def I2(self) -> FloatArray:
        """Return the second invariant, shape (...); 3 at rest.

        It equals the first invariant of the inverse, because det C = 1.
        """
        return np.einsum("...iJ,...iJ->...", self.G, self.G)

    @cached_property
    def g1(self) -> FloatArray:
        """Return the gradient of I1 at fixed volume, shape (..., 3, 3)."""
        return 2 * self.F - (2 / 3) * _wide(self.I1) * self.G

    @cached_property
    def g2(self) -> FloatArray:
        """Return the gradient of I2 at fixed volume, shape (..., 3, 3)."""
        return 2 * (_wide(self.I1) * self.F - self.F @ self.C) - (4 / 3) * _wide(self.I2) * self.G


def shape_of(F: FloatArray) -> Shape:
    """Remove the change of volume from deformation gradients of shape (..., 3, 3)."""
    cofactor = np.cross(F[..., [1, 2, 0], :], F[..., [2, 0, 1], :])
    J = np.einsum("...J,...J->...", F[..., 0, :], cofactor[..., 0, :])
    J = np.where(J.real > 0, J, np.nan)
    scale = J ** (-1 / 3)
    return Shape(_wide(scale) * F, _wide(scale * scale) * cofactor, scale)


def stress(shape: Shape, w1: Scalar, w2: Scalar | None = None) -> FloatArray:
    """Return the first Piola-Kirchhoff stress of a law W(I1bar, I2bar).

    Parameters
    ----------
    shape : Shape
    w1, w2 : ndarray of shape (...) or float
        Slopes dW/dI1bar and dW/dI2bar in MPa; without `w2` the law depends on I1bar only.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        MPa.
    """
    P = _wide(shape.scale * w1) * shape.g1
    if w2 is not None:
        P += _wide(shape.scale * w2) * shape.g2
    return P


def tangent_of_first(shape: Shape, w1: Scalar, w11: Scalar) -> FloatArray:
    """Return the second derivative of a law W(I1bar) with respect to F.

    Parameters
    ----------
    shape : Shape
    w1, w11 : ndarray of shape (...) or float
        First and second derivatives of W in I1bar, in MPa.

    Returns
    -------
    ndarray, shape (..., 3, 3, 3, 3)
        Ordered iJkL, in MPa.
    """
    return tangent_of_quadratic(shape, shape.I1, shape.g1, np.eye(3), w1, w11)


def tangent_of_quadratic(
    shape: Shape, I: FloatArray, g: FloatArray, S: FloatArray, w: Scalar, ww: Scalar
) -> FloatArray:
    """Return d2W/dF2 at J = 1 of a law W of one invariant, ``I = tr(F S F^T)``.

    Parameters
    ----------
    shape : Shape
    I : ndarray, shape (...)
        The invariant.
    g : ndarray, shape (..., 3, 3)
        Its gradient at fixed volume, ``2 F S - 2/3 I G``.
    S : ndarray, shape (..., 3, 3)
        Identity for I1, the dyad of the direction for a fibre's stretch.
    w, ww : ndarray of shape (...) or float
        First and second derivatives of W in I, in MPa.

    Returns
    -------
    ndarray, shape (..., 3, 3, 3, 3)
        Ordered iJkL, in MPa.
    """
    s2 = shape.scale**2
    pressure = (2 / 3) * s2 * w * I
    M = np.empty((*pressure.shape, 2, 2), pressure.dtype)
    M[..., 0, 0] = s2 * ww
    M[..., 0, 1] = M[..., 1, 0] = -(2 / 3) * s2 * w
    M[..., 1, 1] = -(2 / 3) * pressure
    A = _outer_products((g, shape.G), M)
    A += _crossed(shape.G, pressure)
    _add_delta_ik(A, _wide(2 * s2 * w) * S)
    return A


def tangent_of_both(
    shape: Shape, w1: Scalar, w2: Scalar, w11: Scalar, w12: Scalar, w22: Scalar
) -> FloatArray:
    """Return the second derivative of a law W(I1bar, I2bar) with respect to F.

    Parameters
    ----------
    shape : Shape
    w1, w2, w11, w12, w22 : ndarray of shape (...) or float
        First and second derivatives of W in I1bar and I2bar, in MPa.

    Returns
    -------
    ndarray, shape (..., 3, 3, 3, 3)
        Ordered iJkL, in MPa.
    """
    s2 = shape.scale**2
    first, second = s2 * w1, s2 * w2
    M = np.zeros((*s2.shape, 4, 4), s2.dtype)
    M[..., 0, 0] = s2 * w11
    M[..., 1, 1] = s2 * w22
    M[..., 0, 1] = M[..., 1, 0] = s2 * w12
    M[..., 0, 2] = M[..., 2, 0] = -(2 / 3) * first
    M[..., 1, 2] = M[..., 2, 1] = -(4 / 3) * second
    M[..., 2, 2] = -(4 / 9) * first * shape.I1 - (16 / 9) * second * shape.I2
    M[..., 3, 3] = 4 * second
    A = _outer_products((shape.g1, shape.g2, shape.G, shape.F), M)
    A += _crossed(shape.G, (2 / 3) * first * shape.I1 + (4 / 3) * second * shape.I2)
    A -= _crossed(shape.F, 2 * second)
    B = shape.F @ np.swapaxes(shape.F, -1, -2)
    _add_delta_ik(A, _wide(2 * (first + second * shape.I1)) * np.eye(3))
    _add_delta_ik(A, -2 * _wide(second) * shape.C)
    _add_delta_jl(A, -2 * _wide(second) * B)
    return A


def _wide(scalars: FloatArray) -> FloatArray:
    return scalars[..., None, None]


def _outer_products(vectors: tuple[FloatArray, ...], M: FloatArray) -> FloatArray:
    """Sum ``M_ab v_a (x) v_b``, shape (..., 3, 3, 3, 3)."""
    leading = M.shape[:-2]
    V = np.stack(np.broadcast_arrays(*vectors), axis=-3)
    V = V.reshape(*V.shape[:-2], 9)
    return (np.swapaxes(V, -1, -2) @ (M @ V)).reshape(*leading, 3, 3, 3, 3)


def _crossed(X: FloatArray, weight: FloatArray) -> FloatArray:
    """Return ``weight X_iL X_kJ``."""
    left = (_wide(weight) * X)[..., :, None, None, :]
    return left * np.swapaxes(X, -1, -2)[..., None, :, :, None]


def _add_delta_ik(A: FloatArray, S: FloatArray) -> None:
    for i in range(3):
        A[..., i, :, i, :] += S


def _add_delta_jl(A: FloatArray, S: FloatArray) -> None:
    for J in range(3):
        A[..., :, J, :, J] += S


MOST_THICKNESS_ITERATIONS = 60
# Steps of the logarithm of the thickness stretch: the last one, after which the error is about
# its square, and the longest one.
THINNEST, THICKEST = 1e-7, 0.5


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
    for _ in range(MOST_THICKNESS_ITERATIONS):
        across = np.exp(log)
        F[:, 2, 2] = across
        P = law.stress(F)[:, 2, 2] + kappa_mpa * (area * across - 1) * area
        slope = law.tangent(F)[:, 2, 2, 2, 2] + kappa_mpa * area**2
        step = -P / np.maximum(across * slope + P, 1e-3 * across * slope)
        log = log + np.clip(step, -THICKEST, THICKEST)
        if not np.nanmax(np.abs(step), initial=0.0) > THINNEST:
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
