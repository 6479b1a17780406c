r"""Ogden's law: powers of the principal stretches.

With :math:`q_a = \bar\lambda_a^{\alpha}` of one term and their mean m,

.. math:: \tau_a = \lambda_a \frac{\partial W}{\partial \lambda_a} = \mu (q_a - m), \quad
          \frac{\partial \tau_a}{\partial \ln \lambda_b}
          = \mu \alpha (\delta_{ab} q_a - \tfrac13 (q_a + q_b) + \tfrac13 m) .

In the frame of the principal directions, n_a in the deformed and N_a in the
undeformed body, the tangent has the entries aabb, and for a != b

.. math:: A_{abba} = \lambda_a \lambda_b D_{ab}, \quad A_{abab} = s_b + \lambda_a^2 D_{ab},
          \quad D_{ab} = \frac{s_a - s_b}{\lambda_a^2 - \lambda_b^2},
          \quad s_a = \frac{\tau_a}{\lambda_a^2} .

Where two stretches coincide, D is 0/0. It is never computed by that division: with
:math:`x = \ln(\lambda_a / \lambda_b)` and :math:`\beta = \alpha/2 - 1`,

.. math:: D_{ab} = \frac{\mu}{\lambda_a^2 \lambda_b^2}
          \left( (\bar\lambda_a \bar\lambda_b)^{\alpha/2} \frac{\sinh \beta x}{\sinh x}
          + m \right)

is exact, and smooth through x = 0, where the quotient is beta.
"""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.elastic_law import Shape, require, shape_of

Convention = Literal["ogden", "abaqus", "febio"]


@dataclass(frozen=True, slots=True)
class Ogden:
    r"""Ogden's law: a sum of any number of powers of the principal stretches.

    .. math:: W = \sum_p \frac{\mu_p}{\alpha_p} \left( \bar\lambda_1^{\alpha_p}
              + \bar\lambda_2^{\alpha_p} + \bar\lambda_3^{\alpha_p} - 3 \right)

    Three conventions are in use; the constants here follow the first. `from_convention`
    accepts the others.

    ======  ================  ===========================  ================
    name    factor of a term  used by                      mu0
    ======  ================  ===========================  ================
    ogden   mu / alpha        Ogden 1972, Ansys            sum of mu alpha/2
    abaqus  2 mu / alpha^2    Abaqus, many brain papers    sum of mu
    febio   c / alpha^2       FEBio                        sum of c/2
    ======  ================  ===========================  ================

    Parameters
    ----------
    mu_mpa : tuple of float
        MPa, one per term, of either sign; half of sum mu alpha, the shear modulus, is > 0.
    alpha : tuple of float
        Exponents, none zero; 2 alone is neo-Hookean, 2 and -2 are Mooney-Rivlin.

    Raises
    ------
    InputError
        If lengths differ, an exponent is zero or the shear modulus is not positive.

    References
    ----------
    R. W. Ogden, Proc. R. Soc. Lond. A 326 (1972) 565-584.
    J. C. Simo and R. L. Taylor, Comput. Methods Appl. Mech. Eng. 85 (1991) 273-310.

    Examples
    --------
    >>> law = Ogden.from_convention("abaqus", mu_mpa=(0.001,), alpha=(-20.0,))
    >>> law.shear_modulus_mpa
    0.001
    """

    mu_mpa: tuple[float, ...]
    alpha: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.mu_mpa or len(self.mu_mpa) != len(self.alpha):
            raise InputError(
                "An Ogden law needs one exponent for every modulus, got "
                f"{len(self.mu_mpa)} moduli and {len(self.alpha)} exponents."
            )
        if 0 in self.alpha:
            raise InputError(f"The exponents of an Ogden law must not be 0, got {self.alpha}.")
        mu0 = {"the shear modulus sum(mu alpha)/2": self.shear_modulus_mpa}
        require("An Ogden law", self, mu0, (*self.mu_mpa, *self.alpha))

    @classmethod
    def from_convention(
        cls, convention: Convention, mu_mpa: tuple[float, ...], alpha: tuple[float, ...]
    ) -> "Ogden":
        """Return the law for moduli in another convention (see the table above).

        Raises
        ------
        InputError
            If the convention is unknown, or for the reasons of `Ogden`.
        """
        factors = {"abaqus": 2.0, "febio": 1.0}
        if convention == "ogden" or len(mu_mpa) != len(alpha) or 0 in alpha:
            return cls(mu_mpa, alpha)
        if convention not in factors:
            raise InputError(
                f"Ogden conventions are ogden, {', '.join(factors)}; got {convention!r}."
            )
        factor = factors[convention]
        return cls(tuple(factor * m / a for m, a in zip(mu_mpa, alpha, strict=True)), alpha)

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus at rest, half of sum mu alpha."""
        return sum(m * a for m, a in zip(self.mu_mpa, self.alpha, strict=True)) / 2

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy, see `Law.energy`."""
        log_stretch, _ = _stretches(F, shape_of(F))
        energy = np.zeros(log_stretch.shape[:-1])
        for mu, alpha in zip(self.mu_mpa, self.alpha, strict=True):
            energy += mu / alpha * np.expm1(alpha * log_stretch).sum(axis=-1)
        return energy

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the stress, see `Law.stress`."""
        shape = shape_of(F)
        log_stretch, N = _stretches(F, shape)
        s = self._kirchhoff(log_stretch) * np.exp(-2 * log_stretch)
        S = (N * s[..., None, :]) @ np.swapaxes(N, -1, -2)
        return shape.scale[..., None, None] * (shape.F @ S)

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the tangent, see `Law.tangent`."""
        shape = shape_of(F)
        log_stretch, N = _stretches(F, shape)
        stretch = np.exp(log_stretch)
        n = (shape.F @ N) / stretch[..., None, :]
        leading = stretch.shape[:-1]
        # Columns: the dyads n_a (x) N_b, in the order of the rows of the entries.
        T = (n[..., :, None, :, None] * N[..., None, :, None, :]).reshape(*leading, 9, 9)
        entries = self._entries(log_stretch, stretch) * (shape.scale**2)[..., None, None]
        return (T @ entries @ np.swapaxes(T, -1, -2)).reshape(*leading, 3, 3, 3, 3)

    def _kirchhoff(self, log_stretch: FloatArray) -> FloatArray:
        """Return principal Kirchhoff stresses tau, shape (..., 3), in MPa."""
        tau = np.zeros(log_stretch.shape)
        for mu, alpha in zip(self.mu_mpa, self.alpha, strict=True):
            q = np.expm1(alpha * log_stretch)
            tau += mu * (q - q.mean(axis=-1, keepdims=True))
        return tau

    def _entries(self, log_stretch: FloatArray, stretch: FloatArray) -> FloatArray:
        """Return the tangent in the principal frame at J = 1, shape (..., 9, 9)."""
        tau = self._kirchhoff(log_stretch)
        slope, D = self._slopes(log_stretch, stretch)
        A = np.zeros((*stretch.shape[:-1], 3, 3, 3, 3))
        for a, b in product(range(3), repeat=2):
            both = stretch[..., a] * stretch[..., b]
            if a == b:
                A[..., a, a, a, a] = (slope[..., a, a] - tau[..., a]) / both
                continue
            A[..., a, a, b, b] = slope[..., a, b] / both
            A[..., a, b, b, a] = both * D[..., a, b]
            A[..., a, b, a, b] = (
                tau[..., b] / stretch[..., b] ** 2 + stretch[..., a] ** 2 * D[..., a, b]
            )
        return A.reshape(*stretch.shape[:-1], 9, 9)

    def _slopes(
        self, log_stretch: FloatArray, stretch: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return ``d tau_a / d ln lambda_b`` and D of the module docstring, each (..., 3, 3)."""
        slope = np.zeros((*stretch.shape, 3))
        D = np.zeros((*stretch.shape, 3))
        x = log_stretch[..., :, None] - log_stretch[..., None, :]
        between = log_stretch[..., :, None] + log_stretch[..., None, :]
        for mu, alpha in zip(self.mu_mpa, self.alpha, strict=True):
            q = np.exp(alpha * log_stretch)
            m = q.mean(axis=-1)[..., None, None]
            sums = q[..., :, None] + q[..., None, :]
            slope += mu * alpha * (q[..., None] * np.eye(3) + (m - sums) / 3)
            D += mu * (np.exp(alpha / 2 * between) * _sinh_quotient(alpha / 2 - 1, x) + m)
        return slope, D * np.exp(-2 * between)


def _stretches(F: FloatArray, shape: Shape) -> tuple[FloatArray, FloatArray]:
    """Return the logarithms of the stretches at J = 1, (..., 3), and directions N_a in columns.

    They are computed from the eigenvalues of ``C - 1``, formed without cancellation, so that
    small strains keep their digits.
    """
    exists = np.isfinite(shape.scale)  # LAPACK rejects nan
    H = np.where(exists[..., None, None], F - np.eye(3), 0.0)
    H_T = np.swapaxes(H, -1, -2)
    strain, N = np.linalg.eigh(H + H_T + H_T @ H)
    log_stretch = np.log1p(np.maximum(strain, -1 + 1e-15)) / 2
    log_stretch -= log_stretch.mean(axis=-1, keepdims=True)
    return np.where(exists[..., None], log_stretch, np.nan), N


def _sinh_quotient(beta: float, x: FloatArray) -> FloatArray:
    """Return ``sinh(beta x) / sinh(x)``, which tends to beta as x vanishes."""
    near = np.abs(x) < 1e-8  # closer than this the quotient is beta to rounding
    safe = np.where(near, 1.0, x)
    return np.where(near, beta, np.sinh(beta * safe) / np.sinh(safe))
