"""Orthant probabilities of multivariate normal distributions.

The variables are separated after A. Genz, J. Comput. Graph. Stat. 1 (1992) 141, in logarithms,
which keeps far tails precise. One variable is exact; several are averaged over a fixed lattice of
points, so results are reproducible.
"""

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from palpate.storage.values import FloatArray

POINTS = 1021
# Generators of Richtmyer's lattice: a motion of the base and a rotation of the frame have nine
# parameters together, and two more effects have a few.
ROOTS = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0, 41.0, 43.0])


def _log_uniform() -> FloatArray:
    lattice = ROOTS[:, None] * np.arange(1, POINTS + 1) + 0.5
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
        for j, one in enumerate(drawn):
            bound = bound - factor[..., i, j, None] * one
        log_above = log_ndtr(-bound / factor[..., i, i, None])
        total = total + log_above
        if i < d - 1:
            drawn.append(-ndtri_exp(LOG_UNIFORM[i] + log_above))
    top = total.max(axis=-1)
    return np.asarray(top + np.log(np.exp(total - top[..., None]).mean(axis=-1)))
