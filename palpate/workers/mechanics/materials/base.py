"""Interface of elastic laws.

A law is a frozen value, independent of any mesh. Its methods take stacks of deformation
gradients and keep the leading axes, so the same code serves one point and a million.

An isochoric law depends only on the change of shape, ``Fbar = J^(-1/3) F``. The solver
adds the volumetric energy ``kappa/2 (J - 1)^2`` itself, because its evaluation, in each
element or averaged at nodes, is part of the discretisation.

From ``W(s F) = W(F)`` follow ``P(s F) = P(F) / s`` and ``A(s F) = A(F) / s^2``.
The laws here use this: they are evaluated at J = 1 and scaled.
"""

from typing import Protocol

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
