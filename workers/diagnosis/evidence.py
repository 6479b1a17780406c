r"""Laplace's log evidence of a fit: how probable the data are under a hypothesis.

.. math:: \ln p = -\tfrac12 \chi^2 - \tfrac12 \delta'\Lambda\delta + \tfrac12 g'H^{-1}g
          - \tfrac12 \ln|H| - \sum \ln sd + n_1 \ln 2 + \ln \Pr(\text{one-sided} > 0),

with :math:`H = J'C^{-1}J + \Lambda`, the gradient g, which is zero at a converged inner
optimum, and n_1 half-normal priors. The last term is the part of the posterior normal,
centred one Newton step away, that lies on the admissible side; it makes the formula hold
at a bound, where g is not zero. What all hypotheses share, -(m/2) ln 2 pi - ln|C|/2, is
left out: hypotheses with different numbers of parameters compare, other data do not.

Exact for a linear model; D. J. C. MacKay, Neural Computation 4 (1992) 415, for others.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from storage.values import BoolArray, FloatArray, IntArray
from workers.diagnosis.gaussian_orthant import log_orthant
from workers.diagnosis.linearisation import Linearised


class Quadratic(NamedTuple):
    """The misfit around a fit, for n vectors of residuals at once.

    Parameters are counted in prior standard deviations.

    Parameters
    ----------
    misfit : ndarray, shape (n,)
        ``rho' M rho`` with M the precision of the noise in whitened space.
    gradient : ndarray, shape (p, n)
        ``A' M rho``.
    curvature : ndarray, shape (p, p)
        ``A' M A``.
    log_determinant : float
        ``-ln|M|``.
    """

    misfit: FloatArray
    gradient: FloatArray
    curvature: FloatArray
    log_determinant: float = 0.0

    def of(self, which: IntArray) -> "Quadratic":
        """Return the same with only some of the parameters free."""
        return self._replace(
            gradient=self.gradient[which], curvature=self.curvature[np.ix_(which, which)]
        )

    def scaled(self, factors: FloatArray) -> "Quadratic":
        """Return the same for prior standard deviations that are larger by factors, (p,)."""
        return self._replace(
            gradient=self.gradient * factors[:, None],
            curvature=self.curvature * factors[:, None] * factors,
        )


class Posterior(NamedTuple):
    """Of the parameters, in prior standard deviations: mean (p, n), covariance (p, p)."""

    mean: FloatArray
    covariance: FloatArray


def quadratic(at: Linearised) -> Quadratic:
    """Return the misfit of one fit with the noise as it is."""
    A, rho = at.scaled_nominal, at.whitened_residual[:, None]
    return Quadratic((rho**2).sum(axis=0), A.T @ rho, A.T @ A)


def posterior(q: Quadratic, offset: FloatArray) -> Posterior:
    """Return where the parameters lie from their prior means.

    Parameters
    ----------
    q : Quadratic
    offset : ndarray, shape (p,)
        Where the fit lies from there.
    """
    p = len(offset)
    covariance = np.asarray(np.linalg.inv(np.eye(p) + q.curvature), dtype=np.float64)
    step = covariance @ (q.gradient + offset[:, None])
    return Posterior(offset[:, None] - step, covariance)


def log_marginal(q: Quadratic, offset: FloatArray, one_sided: BoolArray) -> FloatArray:
    """Return the log evidence of n vectors of residuals.

    Parameters
    ----------
    q : Quadratic
    offset : ndarray, shape (p,)
        Fit minus prior mean, in prior standard deviations.
    one_sided : ndarray of bool, shape (p,)
        Parameters with a half-normal prior, from their prior mean upwards.

    Returns
    -------
    ndarray, shape (n,)
    """
    p = len(offset)
    H = cho_factor(np.eye(p) + q.curvature, lower=True)
    gradient = q.gradient + offset[:, None]
    decrement = (gradient * cho_solve(H, gradient)).sum(axis=0)
    log_H = 2.0 * np.log(np.diag(H[0])).sum()
    found = 0.5 * (decrement - q.misfit - offset @ offset - log_H - q.log_determinant)
    if one_sided.any():
        mean, covariance = posterior(q, offset)
        side = covariance[np.ix_(one_sided, one_sided)]
        found = found + one_sided.sum() * np.log(2.0) + log_orthant(mean[one_sided], side)
    return np.asarray(found)


def log_evidence(at: Linearised, one_sided: BoolArray | None = None) -> float:
    """Return Laplace's log evidence of a refit.

    Parameters
    ----------
    at : Linearised
        With all parameters of the hypothesis, those of its effects too, as nominal ones.
    one_sided : ndarray of bool, shape (p,), optional
        Parameters that may only lie above their prior mean; none.
    """
    if one_sided is None:
        one_sided = np.zeros(len(at.nominal_sd), dtype=bool)
    return float(log_marginal(quadratic(at), at.scaled_offset, one_sided)[0])
