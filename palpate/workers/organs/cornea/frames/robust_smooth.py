"""Robust smoothing of uncertain values with gaps."""

import numpy as np
from scipy.linalg import solveh_banded

from palpate.storage.values import FloatArray

# Residuals beyond this many robust standard deviations have no weight (Tukey's biweight).
TUKEY = 4.685


def robust_smooth(
    values: FloatArray, weights: FloatArray, wavelength: float, rounds: int = 8
) -> FloatArray:
    r"""Return a smooth curve through values, ignoring outliers.

    Minimises :math:`\sum w_i (z_i - v_i)^2 + \lambda \sum (\Delta^3 z_i)^2` (E. Whittaker,
    1923; P. Eilers, Anal. Chem. 75, 2003), reweighted by Tukey's biweight of the residuals.
    A wave of the given length is halved: :math:`\lambda = (2 \sin(\pi / l))^{-6}`; a wave three
    times as long loses 0.1 %. Gaps are bridged by parabolas.

    Parameters
    ----------
    values : ndarray, shape (n,)
        At equal steps; values that are not finite have weight zero.
    weights : ndarray, shape (n,)
        >= 0.
    wavelength : float
        In steps; > 2.
    rounds : int
        Number of reweightings.

    Returns
    -------
    ndarray, shape (n,)
    """
    n = len(values)
    usable = np.isfinite(values) & (weights > 0)
    values = np.where(usable, values, 0.0)
    base = np.where(usable, weights, 0.0)
    penalty = (2 * np.sin(np.pi / wavelength)) ** -6 * _third_differences(n)
    weight = base
    smooth = values
    for _ in range(rounds):
        banded = penalty.copy()
        # A small weight keeps the matrix positive definite even if nearly everything is a gap.
        banded[-1] += weight + 1e-12
        smooth = solveh_banded(banded, weight * values)
        residual = values - smooth
        scale = 1.4826 * float(np.median(np.abs(residual[usable]))) + 1e-9
        fall = np.clip(1 - (residual / (TUKEY * scale)) ** 2, 0.0, None) ** 2
        weight = base * fall
    return np.asarray(smooth)


def _third_differences(n: int) -> FloatArray:
    """Return D^T D of the third differences of n values, upper banded form, shape (4, n)."""
    stencil = np.array([-1.0, 3.0, -3.0, 1.0])
    banded = np.zeros((4, n))
    for i in range(4):
        for j in range(i, 4):
            banded[3 - (j - i), j : n - 3 + j] += stencil[i] * stencil[j]
    return banded
