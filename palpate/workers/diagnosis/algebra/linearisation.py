r"""Linearisation of the model around one fit, with its noise.

Near the fit, the signed distances r between model and image obey

.. math:: r(z) = r + J z = \text{systematic part} + e, \qquad e \sim N(0, C),

with z the change in the parameters and a normal prior on each of them. Whitened by ``C = L L'``,
the noise is standard normal; A and rho denote J and r in that space. Integrating z out leaves the
precision

.. math:: P = (I + A S A')^{-1} = I - A (A'A + \Lambda)^{-1} A',
          \qquad S = \Lambda^{-1} = \mathrm{diag}(sd^2),

which almost removes the part that the parameters can absorb. With flat priors, P is the projection
of the efficient score (C. R. Rao, Proc. Camb. Phil. Soc. 44 (1948) 50; J. Neyman's C(alpha), 1959).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals, their derivatives and their noise at one fit.

    Parameters
    ----------
    residual : ndarray, shape (m,)
        Signed distances of the model from the observed interfaces at the fit, in mm, with all
        states concatenated.
    nominal : ndarray, shape (m, p)
        Derivatives of the residual with respect to the free parameters, in mm per unit.
    nominal_sd : ndarray, shape (p,)
        Prior standard deviations of the parameters, > 0.
    nominal_offset : ndarray, shape (p,)
        Fitted value minus prior mean of each parameter.
    covariance_factor : ndarray, shape (m, m)
        Lower Cholesky factor of the covariance of the noise, in mm; see `factored`.

    Raises
    ------
    InputError
        If shapes do not match, a number is not finite, or a standard deviation or a diagonal entry
        of the factor is not positive.
    """

    residual: FloatArray
    nominal: FloatArray
    nominal_sd: FloatArray
    nominal_offset: FloatArray
    covariance_factor: FloatArray

    def __post_init__(self) -> None:
        m, p = len(self.residual), len(self.nominal_sd)
        expected = {
            "residual": (m,),
            "nominal": (m, p),
            "nominal_sd": (p,),
            "nominal_offset": (p,),
            "covariance_factor": (m, m),
        }
        for name, shape in expected.items():
            found = getattr(self, name)
            if found.shape != shape or not np.isfinite(found).all():
                raise InputError(
                    f"{name} must be finite numbers of shape {shape}, found shape {found.shape}"
                    f" with {int((~np.isfinite(found)).sum())} non-finite numbers."
                )
        if not (self.nominal_sd > 0).all():
            raise InputError(f"nominal_sd must be > 0, found {self.nominal_sd.tolist()}.")
        if not (np.diag(self.covariance_factor) > 0).all():
            raise InputError(
                "covariance_factor must be a lower Cholesky factor with a positive diagonal. "
                "Make it with palpate.workers.diagnosis.algebra.linearisation.factored."
            )

    @property
    def size(self) -> int:
        """The number of residuals, m."""
        return len(self.residual)

    @cached_property
    def whitened_residual(self) -> FloatArray:
        """Whitened residual rho, shape (m,)."""
        return self.whiten(self.residual)

    @cached_property
    def scaled_nominal(self) -> FloatArray:
        """A times the prior standard deviations, shape (m, p): derivatives per prior sd."""
        return self.whiten(self.nominal) * self.nominal_sd

    @cached_property
    def scaled_offset(self) -> FloatArray:
        """Distance of the fit from the prior mean in prior standard deviations, shape (p,)."""
        return self.nominal_offset / self.nominal_sd

    @cached_property
    def efficient_residual(self) -> FloatArray:
        """Part of the whitened residual that the parameters cannot absorb, shape (m,).

        It is ``P (rho - A offset)``, or rho itself if the fit has converged.
        """
        return self.project(self.whitened_residual - self.scaled_nominal @ self.scaled_offset)

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the noise, shape (m, m), in mm^2."""
        return self.covariance_factor @ self.covariance_factor.T

    def whiten(self, values: FloatArray) -> FloatArray:
        """Solve ``L x = values``, shape (m,) or (m, k)."""
        return np.asarray(
            solve_triangular(self.covariance_factor, values, lower=True, check_finite=False)
        )

    def project(self, whitened: FloatArray) -> FloatArray:
        """Return P times whitened values, shape (m,) or (m, k)."""
        A = self.scaled_nominal
        return whitened - A @ cho_solve(self._curvature, A.T @ whitened)

    def freed(self, columns: FloatArray, sd: FloatArray) -> "Linearised":
        """Return the fit with additional free parameters, each at its prior mean.

        Parameters
        ----------
        columns : ndarray, shape (m, q)
            Derivatives of the residual with respect to the new parameters.
        sd : ndarray, shape (q,)
        """
        return Linearised(
            self.residual,
            np.hstack([self.nominal, columns]),
            np.append(self.nominal_sd, sd),
            np.append(self.nominal_offset, np.zeros(len(sd))),
            self.covariance_factor,
        )

    def holding(self, which: BoolArray) -> "Linearised":
        """Return the fit with some parameters, a mask of shape (p,), held at their values."""
        free = ~which
        return Linearised(
            self.residual,
            self.nominal[:, free],
            self.nominal_sd[free],
            self.nominal_offset[free],
            self.covariance_factor,
        )

    @cached_property
    def _curvature(self) -> tuple[FloatArray, bool]:
        A = self.scaled_nominal
        return cho_factor(np.eye(A.shape[1]) + A.T @ A, lower=True)


def factored(covariance: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor of a covariance, shape (m, m).

    Raises
    ------
    InputError
        If the covariance is not positive definite.
    """
    try:
        return np.asarray(cholesky(covariance, lower=True))
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"The covariance of the noise, shape {covariance.shape}, is not positive definite. "
            "Add noise that is independent at each point (a nugget)."
        ) from error
