"""Size of the segmentation noise, learnt from the residuals that nothing smooth explains.

A stated noise is a guess. The scale by which it is wrong, one for each interface, is estimated from
the residuals that no constant, pose or smooth field explains, as the fixed point of restricted
maximum likelihood,

    s^2 = |e|^2 / tr (I - H)^2

over an interface, with H the hat matrix of all these columns (D. A. Harville, J. Am. Stat. Assoc.
72 (1977) 320). This matches the residuals e to their expectation under noise alone. The smooth
field is so large that it is almost free, so a gap is not mistaken for noise.
"""

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS


def noise_scales(
    stated: FloatArray, groups: IntArray, columns: FloatArray, residual: FloatArray
) -> FloatArray:
    """Return the standard deviation of the noise of each group divided by the stated one.

    Parameters
    ----------
    stated : ndarray, shape (m, m)
        Covariance of the segmentation as stated, in mm^2.
    groups : ndarray of int, shape (m,)
        Group of each residual, uncorrelated with the other groups.
    columns : ndarray, shape (m, p)
        All other possible explanations of the residuals, per prior standard deviation, in mm.
    residual : ndarray, shape (m,)
        Residuals in mm.
    """
    settings, p = SETTINGS.noise, columns.shape[1]
    factor = cholesky(stated, lower=True, check_finite=False)
    every = np.column_stack([columns, residual])
    white = solve_triangular(factor, every, lower=True, check_finite=False)
    masks = [groups == g for g in range(int(groups.max()) + 1)]
    grams, counts = [white[mask].T @ white[mask] for mask in masks], [mask.sum() for mask in masks]
    scales = np.ones(len(masks))
    for _ in range(settings.scale_iterations):
        H = sum(gram / scale**2 for gram, scale in zip(grams, scales, strict=True))
        inverse = np.linalg.inv(np.eye(p) + H[:-1, :-1])
        c, hidden = np.append(-inverse @ H[:-1, -1], 1.0), inverse + inverse @ inverse
        after = np.empty_like(scales)
        for g, (gram, count) in enumerate(zip(grams, counts, strict=True)):
            left = count - float((hidden * gram[:-1, :-1]).sum()) / scales[g] ** 2
            after[g] = np.sqrt(float(c @ gram @ c) / max(left, 1.0))
        after = np.clip(after, *settings.scale_bounds)
        settled = np.abs(np.log(after / scales)).max() < settings.scale_settled
        scales = after
        if settled:
            break
    return scales
