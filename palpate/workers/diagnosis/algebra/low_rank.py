"""Low-rank factors of smooth covariances."""

import numpy as np
from scipy.linalg.lapack import dpstrf

from palpate.storage.values import FloatArray


def pivoted(covariance: FloatArray, tolerance: float) -> FloatArray:
    """Return U, shape (m, rank), with ``U U'`` equal to a covariance up to a small diagonal.

    Pivoted Cholesky factorisation, stopped when the remaining variance falls below the tolerance
    (H. Harbrecht, M. Peters and R. Schneider, Appl. Numer. Math. 62 (2012) 428).
    """
    factor, pivots, rank, _ = dpstrf(covariance, tol=tolerance, lower=1)
    U = np.empty((len(covariance), rank))
    U[pivots - 1] = np.tril(factor[:, :rank])
    return U
