r"""Invariants of the change of shape and their derivatives.

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

References
----------
G. A. Holzapfel, Nonlinear Solid Mechanics, Wiley 2000, sections 6.4 and 6.6.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.storage.values import FloatArray

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
