"""Neo-Hookean law."""

from dataclasses import dataclass

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.constants_check import require
from palpate.workers.mechanics.materials.invariants import shape_of, stress, tangent_of_first


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
