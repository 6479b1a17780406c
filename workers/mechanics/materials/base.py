"""Define what every elastic law offers.

A law is a frozen value that knows no mesh. Its methods take stacks of deformation
gradients and keep the leading axes, so one point and a million points run through
the same code.

An isochoric law sees only the change of shape, ``Fbar = J^(-1/3) F``. The solver
adds the energy of the volume itself, ``kappa/2 (J - 1)^2``, because where it is
taken, in each element or averaged at nodes, belongs to the discretisation.

From ``W(s F) = W(F)`` follow ``P(s F) = P(F) / s`` and ``A(s F) = A(F) / s^2``.
The laws here use it: they work at J = 1 and scale the result.
"""

from typing import Protocol

from palpate.storage.values import FloatArray


class Law(Protocol):
    """Define a hyperelastic law W(F)."""

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy per undeformed volume.

        Parameters
        ----------
        F : ndarray, shape (..., 3, 3)
            Deformation gradients.

        Returns
        -------
        ndarray, shape (...)
            MPa (N mm / mm^3); zero at rest.
        """
        ...

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the first Piola-Kirchhoff stress dW/dF, shape (..., 3, 3), in MPa."""
        ...

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the second derivative d2W/dF2, shape (..., 3, 3, 3, 3) ordered iJkL, in MPa."""
        ...


class Isochoric(Law, Protocol):
    """Define a law of the change of shape alone, isotropic, free of stress at rest.

    Where ``det F <= 0`` energy, stress and tangent are nan: no such body exists, and
    a line search that meets nan turns back.
    """

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus mu0 at rest: for small strains ``P = 2 mu0 dev(eps)``."""
        ...
