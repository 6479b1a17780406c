"""The constants of a cornea: an Ogden law of any order with one bulk modulus."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray

Convention = Literal["mu/alpha", "2mu/alpha^2", "mu/alpha^2"]

DEFAULT_BULK_MPA = 10.0  # K_i = 1e7 Pa, thesis section 5.3


class OgdenLaw(NamedTuple):
    """Constants in the form used by compiled loops.

    Parameters
    ----------
    modulus_mpa, exponent : ndarray, shape (N,)
        Factor and power of each term of ``tau_a = sum_i m_i (q_a - mean q)``.
    bulk_mpa : float
    plane_stress_ratio : float
        ``- ln(lambda_3) / (ln(lambda_1) + ln(lambda_2))`` for a small strain in plane stress,
        the initial guess of the thickness.
    """

    modulus_mpa: FloatArray
    exponent: FloatArray
    bulk_mpa: float
    plane_stress_ratio: float


@dataclass(frozen=True, slots=True)
class CorneaConstants:
    r"""Ogden constants with the volumetric term of the thesis.

    .. math:: W = \sum_{i=1}^{N} \left[ c_i \left( \bar\lambda_1^{\alpha_i}
              + \bar\lambda_2^{\alpha_i} + \bar\lambda_3^{\alpha_i} - 3 \right)
              + \frac{K}{2} (J - 1)^{2 i} \right]

    =============  ====================  ==================  =====================
    convention     factor c_i            used by             shear modulus at rest
    =============  ====================  ==================  =====================
    mu/alpha       mu_i / alpha_i        thesis, Ansys       sum of mu alpha / 2
    2mu/alpha^2    2 mu_i / alpha_i^2    Abaqus              sum of mu
    mu/alpha^2     mu_i / alpha_i^2      FEBio               sum of mu / 2
    =============  ====================  ==================  =====================

    Parameters
    ----------
    mu_mpa, alpha : tuple of float
        One value of each per term.
    bulk_mpa : float
        K, the same for all N powers of J - 1.
    convention : {"mu/alpha", "2mu/alpha^2", "mu/alpha^2"}

    Raises
    ------
    InputError
        If the lengths differ, an exponent is zero, a number is not finite, or the shear
        or the bulk modulus is not positive.

    References
    ----------
    M. A. Lago, PhD thesis, Universitat Politecnica de Valencia, 2014, Eq. 5.1.

    Examples
    --------
    >>> round(CorneaConstants(mu_mpa=(0.011, 0.035), alpha=(30, 80)).shear_modulus_mpa, 3)
    1.565
    """

    mu_mpa: tuple[float, ...]
    alpha: tuple[float, ...]
    bulk_mpa: float = DEFAULT_BULK_MPA
    convention: Convention = "mu/alpha"

    def __post_init__(self) -> None:
        if not self.mu_mpa or len(self.mu_mpa) != len(self.alpha):
            raise InputError(
                "The law of a cornea needs one exponent alpha for every modulus mu, got "
                f"{len(self.mu_mpa)} moduli and {len(self.alpha)} exponents."
            )
        if self.convention not in get_args(Convention):
            raise InputError(
                f"Ogden conventions are {', '.join(get_args(Convention))}; got {self.convention!r}."
            )
        if not all(map(math.isfinite, (*self.mu_mpa, *self.alpha, self.bulk_mpa))):
            raise InputError(f"The constants of a cornea must be finite numbers, got {self}.")
        if 0 in self.alpha:
            raise InputError(f"The exponents of an Ogden law must not be 0, got {self.alpha}.")
        if self.shear_modulus_mpa <= 0 or self.bulk_mpa <= 0:
            raise InputError(
                "A cornea needs a positive shear and bulk modulus, got "
                f"{self.shear_modulus_mpa:g} and {self.bulk_mpa:g} MPa. "
                "The shear modulus is the sum of mu alpha / 2 in the convention mu/alpha."
            )

    @property
    def moduli_mpa(self) -> tuple[float, ...]:
        """Return ``c_i alpha_i``, the moduli in the convention mu/alpha."""
        factor = {"mu/alpha": None, "2mu/alpha^2": 2.0, "mu/alpha^2": 1.0}[self.convention]
        if factor is None:
            return self.mu_mpa
        return tuple(factor * m / a for m, a in zip(self.mu_mpa, self.alpha, strict=True))

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus at rest, half of sum ``c_i alpha_i^2``."""
        return sum(m * a for m, a in zip(self.moduli_mpa, self.alpha, strict=True)) / 2

    def law(self) -> OgdenLaw:
        """Return the constants in the form used by compiled loops."""
        lame = self.bulk_mpa - 2 / 3 * self.shear_modulus_mpa
        return OgdenLaw(
            np.array(self.moduli_mpa, dtype=float),
            np.array(self.alpha, dtype=float),
            float(self.bulk_mpa),
            lame / (lame + 2 * self.shear_modulus_mpa),
        )
