r"""Laplace's log evidence of a fit: the log probability of the data under a hypothesis.

.. math:: \ln p = -\tfrac12 \chi^2 - \tfrac12 \delta'\Lambda\delta + \tfrac12 g'H^{-1}g
          - \tfrac12 \ln|H| - \sum \ln sd + n_1 \ln 2 + \ln \Pr(\text{one-sided} > 0),

with :math:`H = J'C^{-1}J + \Lambda`, the gradient g, which is zero at a converged inner optimum,
and n_1 half-normal priors. The last term is the probability of the admissible side under the
posterior normal, centred one Newton step away; it makes the formula hold at a bound, where g is not
zero. A parameter stopped at another bound of its interval is treated in the same way, without the
ln 2. The common term -(m/2) ln 2 pi - ln|C|/2 is omitted, so hypotheses can be compared only on the
same data; their numbers of parameters may differ.

It is exact for a linear model; for others, see D. J. C. MacKay, Neural Computation 4 (1992) 415.

For the orthant probability, the variables are separated after A. Genz, J. Comput. Graph. Stat. 1
(1992) 141, in logarithms, which keeps far tails precise. One variable is exact; several are
averaged over a fixed lattice of points, so results are reproducible.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.linearisation import Linearised

LATTICE_POINTS = 1021
# Generators of Richtmyer's lattice: a motion of the base and a rotation of the frame have nine
# parameters together, and two more effects have a few.
LATTICE_ROOTS = np.sqrt(
    [2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0, 41.0, 43.0]
)


def _log_uniform() -> FloatArray:
    lattice = LATTICE_ROOTS[:, None] * np.arange(1, LATTICE_POINTS + 1) + 0.5
    uniform = np.abs(2.0 * (lattice % 1.0) - 1.0)  # folded, so that the integrand becomes periodic
    return np.asarray(np.log(np.maximum(uniform, np.finfo(float).tiny)))


LOG_UNIFORM = _log_uniform()  # one row for each root


def log_orthant(mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the log probability that all variables are positive.

    Parameters
    ----------
    mean : ndarray, shape (..., d)
        Means of a stack of distributions, d <= 15.
    covariance : ndarray, shape (..., d, d)
        Positive definite covariances, one for each distribution or common to all.

    Returns
    -------
    ndarray, shape (...)

    Examples
    --------
    >>> log_orthant(np.zeros((1, 1)), np.eye(1))
    array([-0.69314718])
    """
    d = mean.shape[-1]
    factor = np.linalg.cholesky(covariance)
    if d < 2:
        return np.asarray(log_ndtr(mean / factor[..., 0]).sum(axis=-1))
    total: FloatArray = np.zeros(())
    drawn: list[FloatArray] = []
    for i in range(d):
        bound = -mean[..., i, None]
        for j, draw in enumerate(drawn):
            bound = bound - factor[..., i, j, None] * draw
        log_above = log_ndtr(-bound / factor[..., i, i, None])
        total = total + log_above
        if i < d - 1:
            drawn.append(-ndtri_exp(LOG_UNIFORM[i] + log_above))
    top = total.max(axis=-1)
    return np.asarray(top + np.log(np.exp(total - top[..., None]).mean(axis=-1)))


class Quadratic(NamedTuple):
    """The quadratic misfit around a fit, or a stack of misfits whose shape is written as dots.

    Parameters are in prior standard deviations.

    Parameters
    ----------
    misfit : ndarray, shape (...)
        ``rho' rho``.
    gradient : ndarray, shape (..., p)
        ``A' rho``.
    curvature : ndarray, shape (..., p, p)
        ``A' A``.
    """

    misfit: FloatArray
    gradient: FloatArray
    curvature: FloatArray


def log_marginal(
    q: Quadratic, offset: FloatArray, one_sided: BoolArray, at_bound: IntArray | None = None
) -> FloatArray:
    """Return the log evidence of each misfit in a stack, shape (...).

    Parameters
    ----------
    q : Quadratic
    offset : ndarray, shape (p,)
        Fit minus prior mean, in prior standard deviations.
    one_sided : ndarray of bool, shape (p,)
        Parameters with a half-normal prior, from their prior mean upwards.
    at_bound : ndarray of int, shape (p,), optional
        Parameters that the fit stopped at a bound, which are restricted to its inner side: 1 at a
        lower bound, -1 at an upper bound, 0 for all others.
    """
    bound = np.zeros(len(offset), np.int32) if at_bound is None else at_bound
    side = np.where(bound != 0, bound, one_sided)
    held, edge = side != 0, np.where(bound != 0, offset, 0.0)
    # Restricted parameters come last: the last corner of the factor has their covariance.
    order = np.argsort(held, kind="stable")
    curvature = q.curvature[..., order[:, None], order]
    L, y = _factored(curvature, (q.gradient + offset)[..., order])
    log_H = 2.0 * np.log(np.diagonal(L, axis1=-2, axis2=-1)).sum(axis=-1)
    evidence = 0.5 * ((y**2).sum(axis=-1) - q.misfit - offset @ offset - log_H)
    if held.any():
        count = int(held.sum())
        inverse = np.linalg.inv(L[..., -count:, -count:]).swapaxes(-1, -2)
        step = (inverse @ y[..., -count:, None])[..., 0]
        inward, away = side[held], (offset - edge)[held]
        covariance = inverse @ inverse.swapaxes(-1, -2) * np.outer(inward, inward)
        evidence = evidence + one_sided.sum() * np.log(2.0)
        evidence = evidence + log_orthant(inward * (away - step), covariance)
    return np.asarray(evidence)


def _factored(curvature: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Cholesky factor L of H and ``L^-1 g``, from the factor of H bordered by g."""
    p = gradient.shape[-1]
    bordered = np.empty((*gradient.shape[:-1], p + 1, p + 1))
    bordered[..., :p, :p], bordered[..., p, :p] = curvature, gradient
    # H is no smaller than the identity, so this corner keeps the matrix positive definite.
    bordered[..., p, p] = (gradient**2).sum(axis=-1)
    every = np.arange(p + 1)
    bordered[..., every, every] += 1.0
    factor = np.linalg.cholesky(bordered)
    return factor[..., :p, :p], factor[..., p, :p]


def log_evidence(
    at: Linearised, one_sided: BoolArray | None = None, at_bound: IntArray | None = None
) -> float:
    """Return the Laplace log evidence of a refit.

    Parameters
    ----------
    at : Linearised
        Linearisation with all parameters of the hypothesis, including its effects, as nominal ones.
    one_sided : ndarray of bool, shape (p,), optional
        Parameters restricted to values above their prior mean; none by default.
    at_bound : ndarray of int, shape (p,), optional
        See `log_marginal`.
    """
    if one_sided is None:
        one_sided = np.zeros(len(at.nominal_sd), dtype=bool)
    A, rho = at.scaled_nominal, at.whitened_residual
    misfit = Quadratic(np.array(rho @ rho), A.T @ rho, A.T @ A)
    return float(log_marginal(misfit, at.scaled_offset, one_sided, at_bound))
