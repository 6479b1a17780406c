"""Fung's exponential law of soft tissue."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.elastic_law import (
    Shape,
    require,
    shape_of,
    stress,
    tangent_of_first,
)


@dataclass(frozen=True, slots=True)
class Fung:
    r"""Exponentially stiffening law, as collagen is straightened.

    .. math:: W = \frac{\mu}{2 b} \left( e^{b (\bar I_1 - 3)} - 1 \right)

    Isotropic form of Fung's exponential in the first invariant (Demiray 1972). As b goes to
    zero it becomes neo-Hookean.

    Parameters
    ----------
    mu_mpa : float
        Shear modulus at rest in MPa, > 0.
    b : float
        Rate of stiffening, > 0, dimensionless.

    Raises
    ------
    InputError
        If a constant is not a positive number.

    Notes
    -----
    Beyond ``b (I1bar - 3) = 709`` the energy is infinite and the stress may be nan.

    References
    ----------
    Y. C. Fung, Am. J. Physiol. 213 (1967) 1532-1544.
    H. Demiray, J. Biomech. 5 (1972) 309-311.

    Examples
    --------
    >>> import numpy as np
    >>> F = np.eye(3)
    >>> F[0, 1] = 1.0  # I1bar = 4
    >>> np.isclose(Fung(0.02, 1.0).energy(F), 0.01 * (np.e - 1))
    np.True_
    """

    mu_mpa: float
    b: float

    def __post_init__(self) -> None:
        require("A Fung law", self, {"mu": self.mu_mpa, "b": self.b})

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus at rest."""
        return self.mu_mpa

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy, see `Law.energy`."""
        with np.errstate(over="ignore"):
            return self.mu_mpa / (2 * self.b) * np.expm1(self.b * (shape_of(F).I1 - 3))

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the stress, see `Law.stress`."""
        shape = shape_of(F)
        with np.errstate(over="ignore", invalid="ignore"):
            return stress(shape, self._slope(shape))

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the tangent, see `Law.tangent`."""
        shape = shape_of(F)
        with np.errstate(over="ignore", invalid="ignore"):
            slope = self._slope(shape)
            return tangent_of_first(shape, slope, self.b * slope)

    def _slope(self, shape: Shape) -> FloatArray:
        return self.mu_mpa / 2 * np.exp(self.b * (shape.I1 - 3))
