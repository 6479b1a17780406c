"""Yeoh's law: a polynomial in the first invariant."""

from dataclasses import dataclass

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.constants_check import require
from palpate.workers.mechanics.materials.invariants import shape_of, stress, tangent_of_first


@dataclass(frozen=True, slots=True)
class Yeoh:
    r"""Yeoh's law: three constants, which a uniaxial test determines.

    .. math:: W = c_1 x + c_2 x^2 + c_3 x^3, \quad x = \bar I_1 - 3

    Parameters
    ----------
    c1_mpa : float
        Half the shear modulus at rest in MPa, > 0.
    c2_mpa, c3_mpa : float
        MPa, of either sign. Usually c2 < 0 < c3 in rubber: it softens, then stiffens.

    Raises
    ------
    InputError
        If c1 is not positive, or a constant is not finite.

    References
    ----------
    O. H. Yeoh, Rubber Chem. Technol. 66 (1993) 754-771.

    Examples
    --------
    >>> import numpy as np
    >>> F = np.eye(3)
    >>> F[0, 1] = 2.0  # x = 4
    >>> round(float(Yeoh(0.1, 0.01, 0.001).energy(F)), 12)
    0.624
    """

    c1_mpa: float
    c2_mpa: float = 0.0
    c3_mpa: float = 0.0

    def __post_init__(self) -> None:
        require("A Yeoh law", self, {"c1": self.c1_mpa}, (self.c2_mpa, self.c3_mpa))

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus at rest, 2 c1."""
        return 2 * self.c1_mpa

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy, see `Law.energy`."""
        x = shape_of(F).I1 - 3
        return x * (self.c1_mpa + x * (self.c2_mpa + x * self.c3_mpa))

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the stress, see `Law.stress`."""
        shape = shape_of(F)
        return stress(shape, self._slope(shape.I1 - 3))

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the tangent, see `Law.tangent`."""
        shape = shape_of(F)
        x = shape.I1 - 3
        return tangent_of_first(shape, self._slope(x), 2 * self.c2_mpa + 6 * self.c3_mpa * x)

    def _slope(self, x: FloatArray) -> FloatArray:
        return self.c1_mpa + x * (2 * self.c2_mpa + x * 3 * self.c3_mpa)
