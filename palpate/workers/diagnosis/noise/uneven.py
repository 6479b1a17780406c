"""Estimation of noise that varies from one end of the body to the other.

The standard deviation of the segmentation is ``s exp(b t)``, with s for each interface and t the
position along each axis, -1 and 1 at the ends of the body. It changes little over a correlation
length, so it remains as the standard deviation of the residuals whitened by the given covariance,
and their squares follow a regression with a logarithmic link (G. K. Smyth, J. R. Stat. Soc. B 51
(1989) 47). As in `workers.diagnosis.noise.learning`, only unexplained residuals are used.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.diagnosis.noise.model import NoiseParts
from palpate.workers.diagnosis.settings.values import SETTINGS


def with_uneven_noise(
    parts: NoiseParts, places: FloatArray, columns: FloatArray, residual: FloatArray
) -> NoiseParts:
    """Return noise whose size varies across the body as the residuals do.

    Parameters
    ----------
    parts : NoiseParts
        Noise of uniform size.
    places : ndarray, shape (m, 3)
        Points at rest, in mm.
    columns : ndarray, shape (m, p)
        Other possible explanations of the residuals, per prior deviation.
    residual : ndarray, shape (m,)
        Residuals in mm.
    """
    ends = places.min(axis=0), places.max(axis=0)
    t = (places - (ends[0] + ends[1]) / 2) / np.maximum((ends[1] - ends[0]) / 2, 1e-9)
    stated = parts.stated[parts.lengths.index(1.0)]
    factor = cholesky(stated, lower=True, check_finite=False)
    every = np.hstack([parts.fixed, parts.numerical, columns, residual[:, None]])
    white = solve_triangular(factor, every, lower=True, check_finite=False)
    of_interface = parts.groups[:, None] == np.unique(parts.groups)
    return with_factors(parts, np.exp(t @ _slopes(white, of_interface, t)))


def with_factors(parts: NoiseParts, factors: FloatArray) -> NoiseParts:
    """Return noise with deviations scaled by a factor for each residual, shape (m,)."""
    stated = tuple(one * factors[:, None] * factors for one in parts.stated)
    return replace(parts, stated=stated, uneven=factors)


def _slopes(white: FloatArray, of_interface: BoolArray, t: FloatArray) -> FloatArray:
    """Return the slopes b along each axis, shape (3,), by Fisher scoring.

    The last whitened column is the residual.
    """
    settings, X, y = SETTINGS.noise, white[:, :-1], white[:, -1]
    design = np.hstack([of_interface, t]).astype(np.float64)
    levels = of_interface.shape[1]
    prior = np.diag(np.repeat([0.0, settings.uneven_sd**-2], [levels, t.shape[1]]))
    theta = np.zeros(design.shape[1])
    for _ in range(settings.scale_iterations):
        s = np.exp(design @ theta)
        A, r = X / s[:, None], y / s
        inverse = np.linalg.inv(np.eye(A.shape[1]) + A.T @ A)
        left = r - A @ (inverse @ (A.T @ r))
        # Diagonal of (I - H)^2: the fraction of the noise variance left in each residual.
        kept = 1.0 - ((A @ (inverse + inverse @ inverse)) * A).sum(axis=1)
        score = design.T @ (left**2 - kept) - prior @ theta
        step = np.linalg.solve(2.0 * (design * kept[:, None]).T @ design + prior, score)
        theta = theta + np.clip(step, -1.0, 1.0)
        if np.abs(step).max() < settings.scale_settled:
            break
    return theta[levels:]
