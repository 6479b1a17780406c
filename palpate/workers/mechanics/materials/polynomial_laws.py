"""Laws that are polynomials in the invariants: neo-Hookean, Yeoh and Mooney-Rivlin.

The neo-Hookean law is linear in the first invariant, Yeoh's is a polynomial in it, and the
Mooney-Rivlin law one in both invariants.
"""

from dataclasses import dataclass

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.elastic_law import (
    Shape,
    require,
    shape_of,
    stress,
    tangent_of_both,
    tangent_of_first,
)


@dataclass(frozen=True, slots=True)
class NeoHookean:
    r"""Neo-Hookean law: one constant, valid up to about 30 % strain.

    .. math:: W = \frac{\mu}{2} (\bar I_1 - 3)

    Parameters
    ----------
    mu_mpa : float
        Shear modulus in MPa, > 0; E / 2(1 + nu) in terms of Young's modulus.

    Raises
    ------
    InputError
        If the modulus is not a positive number.

    References
    ----------
    L. R. G. Treloar, Trans. Faraday Soc. 39 (1943) 241-246.

    Examples
    --------
    Simple shear by gamma stores ``mu/2 gamma^2``:

    >>> import numpy as np
    >>> F = np.eye(3)
    >>> F[0, 1] = 2.0
    >>> round(float(NeoHookean(0.01).energy(F)), 12)
    0.02
    """

    mu_mpa: float

    def __post_init__(self) -> None:
        require("A neo-Hookean law", self, {"mu": self.mu_mpa})

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus at rest."""
        return self.mu_mpa

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy, see `Law.energy`."""
        return self.mu_mpa / 2 * (shape_of(F).I1 - 3)

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the stress, see `Law.stress`."""
        return stress(shape_of(F), self.mu_mpa / 2)

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the tangent, see `Law.tangent`."""
        return tangent_of_first(shape_of(F), self.mu_mpa / 2, 0.0)


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


@dataclass(frozen=True, slots=True)
class MooneyRivlin:
    r"""Polynomial of second order in both invariants; with two constants, Mooney's law of 1940.

    .. math:: W = c_{10} x + c_{01} y + c_{20} x^2 + c_{11} x y + c_{02} y^2,
              \quad x = \bar I_1 - 3, \quad y = \bar I_2 - 3

    Parameters
    ----------
    c10_mpa, c01_mpa : float
        MPa; their sum, half the shear modulus at rest, is > 0.
    c20_mpa, c11_mpa, c02_mpa : float
        MPa, of either sign.

    Raises
    ------
    InputError
        If c10 + c01 is not positive, or a constant is not finite.

    Notes
    -----
    Five constants fitted to one kind of test often predict nonsense for another; fit several
    kinds together (`workers.mechanics.materials.law_fit`). With a negative constant the energy may
    fall without bound at large strains, and a body then collapses.

    References
    ----------
    M. Mooney, J. Appl. Phys. 11 (1940) 582-592.
    R. S. Rivlin and D. W. Saunders, Phil. Trans. R. Soc. A 243 (1951) 251-288.

    Examples
    --------
    In simple shear by gamma both x and y are gamma^2:

    >>> import numpy as np
    >>> F = np.eye(3)
    >>> F[0, 1] = 2.0
    >>> round(float(MooneyRivlin(1.0, 2.0, 3.0, 4.0, 5.0).energy(F)), 12)
    204.0
    """

    c10_mpa: float
    c01_mpa: float = 0.0
    c20_mpa: float = 0.0
    c11_mpa: float = 0.0
    c02_mpa: float = 0.0

    def __post_init__(self) -> None:
        require(
            "A Mooney-Rivlin law",
            self,
            {"c10 + c01": self.c10_mpa + self.c01_mpa},
            (self.c20_mpa, self.c11_mpa, self.c02_mpa),
        )

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus at rest, 2 (c10 + c01)."""
        return 2 * (self.c10_mpa + self.c01_mpa)

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy, see `Law.energy`."""
        shape = shape_of(F)
        x, y = shape.I1 - 3, shape.I2 - 3
        return x * (self.c10_mpa + self.c20_mpa * x + self.c11_mpa * y) + y * (
            self.c01_mpa + self.c02_mpa * y
        )

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the stress, see `Law.stress`."""
        shape = shape_of(F)
        return stress(shape, *self._slopes(shape))

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the tangent, see `Law.tangent`."""
        shape = shape_of(F)
        curvatures = 2 * self.c20_mpa, self.c11_mpa, 2 * self.c02_mpa
        return tangent_of_both(shape, *self._slopes(shape), *curvatures)

    def _slopes(self, shape: Shape) -> tuple[FloatArray, FloatArray]:
        x, y = shape.I1 - 3, shape.I2 - 3
        return (
            self.c10_mpa + 2 * self.c20_mpa * x + self.c11_mpa * y,
            self.c01_mpa + self.c11_mpa * x + 2 * self.c02_mpa * y,
        )
