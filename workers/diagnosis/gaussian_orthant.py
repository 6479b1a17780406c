"""How much of a normal distribution is positive.

Separation of variables after A. Genz, J. Comput. Graph. Stat. 1 (1992) 141, in
logarithms, so that far tails keep their digits. One variable is exact; more are averaged
over a fixed lattice of points, so the same input gives the same number.
"""

import numpy as np
from scipy.linalg import cholesky
from scipy.special import log_ndtr, logsumexp, ndtri_exp

from storage.values import FloatArray

POINTS = 1021
ROOTS = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0])  # generators of Richtmyer's lattice


def log_orthant(mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return log probability that all variables are positive.

    Parameters
    ----------
    mean : ndarray, shape (d, n)
        A column for each of n distributions, d <= 9.
    covariance : ndarray, shape (d, d)
        Common to them, positive definite.

    Returns
    -------
    ndarray, shape (n,)

    Examples
    --------
    >>> log_orthant(np.zeros((1, 1)), np.eye(1))
    array([-0.69314718])
    """
    d, n = mean.shape
    if d == 0:
        return np.zeros(n)
    factor = cholesky(covariance, lower=True)
    lattice = np.arange(1, POINTS + 1)[:, None] * ROOTS[: d - 1] + 0.5
    uniform = np.abs(2.0 * (lattice % 1.0) - 1.0)  # folded: the integrand becomes periodic
    log_uniform = np.log(np.maximum(uniform, np.finfo(float).tiny))
    total = np.zeros((n, POINTS if d > 1 else 1))
    drawn: list[FloatArray] = []
    for i in range(d):
        bound = -mean[i][:, None] - sum((factor[i, j] * drawn[j] for j in range(i)), np.zeros(()))
        log_above = log_ndtr(-bound / factor[i, i])
        total = total + log_above
        if i < d - 1:
            drawn.append(-ndtri_exp(log_uniform[:, i] + log_above))
    return np.asarray(logsumexp(total, axis=1) - np.log(total.shape[1]))
