"""Amplitude, correlation length and unevenness of the noise, learnt from unexplained residuals.

The scales are estimated from the residuals that no constant, nuisance or smooth field explains, as
the fixed point of restricted maximum likelihood, ``s^2 = |e|^2 / tr (I - H)^2`` for each interface,
with H the hat matrix of all these columns (D. A. Harville, J. Am. Stat. Assoc. 72 (1977) 320). This
matches the residuals e to their expectation under noise alone, so a strong effect is not mistaken
for noise. A thousand residuals determine a scale to within a few per cent, so it is fixed at its
optimum.

The noise may vary from one end of the body to the other. The standard deviation of the segmentation
is then ``s exp(b t)``, with s for each interface and t the position along each axis, -1 and 1 at
the ends of the body. It changes little over a correlation length, so it remains as the standard
deviation of the residuals whitened by the given covariance, and their squares follow a regression
with a logarithmic link (G. K. Smyth, J. R. Stat. Soc. B 51 (1989) 47). Again, only unexplained
residuals are used.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.special import logsumexp

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.noise.noise_components import NoiseParts, NoiseState, weighted_sum


def learnt_states(
    parts: NoiseParts, columns: FloatArray, residual: FloatArray, field: FloatArray
) -> list[NoiseState]:
    """Return the noise states to average over.

    The scales are optimal for each length and size of the numerical error. The likeliest state
    comes first; far less likely states are omitted.

    Parameters
    ----------
    parts : NoiseParts
    columns : ndarray, shape (m, p)
        Derivatives of the residuals with respect to the constants, per prior standard deviation.
    residual : ndarray, shape (m,)
    field : ndarray, shape (m, r)
        Columns of a smooth field of medium amplitude, which absorbs a possible gap.
    """
    settings = SETTINGS.noise
    groups = int(parts.groups.max()) + 1
    masks = [parts.groups == g for g in range(groups)]
    counts = np.array([mask.sum() for mask in masks])
    every = np.hstack([parts.fixed, parts.numerical, columns, field, residual[:, None]])
    first, past = parts.fixed.shape[1], parts.fixed.shape[1] + parts.numerical.shape[1]
    scales = np.ones(groups)
    states: list[tuple[float, NoiseState]] = []
    for n, length in enumerate(parts.lengths):
        factor = cholesky(parts.stated[n], lower=True, check_finite=False)
        white = solve_triangular(factor, every, lower=True, check_finite=False)
        grams = [white[mask].T @ white[mask] for mask in masks]
        stated = float(np.log(np.diag(factor)).sum())
        for numerical in settings.numerical_scales:
            d = np.ones(every.shape[1])
            d[first:past] = numerical
            scaled = [gram * d[:, None] * d for gram in grams]
            scales = _optimum(scaled, counts, scales)
            prior = _log_prior(scales, length, numerical)
            value = _log_likelihood(scaled, counts, scales) - stated + prior
            states.append((value, NoiseState(n, scales, numerical, prior)))
    states.sort(key=lambda one: -one[0])
    kept = [state for value, state in states if value > states[0][0] - settings.hopeless_nats]
    total = float(logsumexp([state.log_weight for state in kept]))
    shares = np.exp([value - states[0][0] for value, _ in states[: len(kept)]])
    shares /= shares.sum()
    return [
        replace(state, log_weight=state.log_weight - total, share=float(share))
        for state, share in zip(kept, shares, strict=True)
    ]


def _optimum(grams: Sequence[FloatArray], counts: IntArray, scales: FloatArray) -> FloatArray:
    """Return the scale of each group, the fixed point of restricted maximum likelihood.

    The prior on its logarithm acts like additional residuals. The last row and column of the
    products belong to the residual.
    """
    settings = SETTINGS.noise
    for _ in range(settings.scale_iterations):
        weights = 1.0 / scales**2
        H = weighted_sum(weights, grams)
        inverse = _inverse(np.eye(len(H) - 1) + H[:-1, :-1])
        c = np.append(-inverse @ H[:-1, -1], 1.0)
        hidden = inverse + inverse @ inverse  # 2 A - A H A, with A the inverse of I + H
        after = np.empty_like(scales)
        for g, gram in enumerate(grams):
            left = float(c @ gram @ c)
            leverage = float((hidden * gram[:-1, :-1]).sum()) * weights[g]
            pull = np.log(scales[g]) / (settings.scale_log_sd**2 + settings.interface_log_sd**2)
            after[g] = np.sqrt(left / max(counts[g] - leverage + pull, 1.0))
        after = np.clip(after, *settings.scale_bounds)
        settled = np.abs(np.log(after / scales)).max() < settings.scale_settled
        scales = after
        if settled:
            break
    return scales


def _inverse(positive: FloatArray) -> FloatArray:
    """Return the inverse of a positive definite matrix, twice as fast as the general inverse."""
    factor, _ = dpotrf(positive, lower=1)
    found, _ = dpotri(factor, lower=1)
    return np.asarray(np.tril(found) + np.tril(found, -1).T)


def _log_likelihood(grams: Sequence[FloatArray], counts: IntArray, scales: FloatArray) -> float:
    H = weighted_sum(1.0 / scales**2, grams)
    L = cholesky(np.eye(len(H) - 1) + H[:-1, :-1], lower=True)
    y = solve_triangular(L, H[:-1, -1], lower=True)
    misfit = float(H[-1, -1] - y @ y)
    return -0.5 * misfit - float(counts @ np.log(scales)) - float(np.log(np.diag(L)).sum())


def _log_prior(scales: FloatArray, length: float, numerical: float) -> float:
    """Return the unnormalised log prior of a state, with common and per-interface scales."""
    settings = SETTINGS.noise
    logs = np.log(scales)
    common = float(logs.mean())
    found = -0.5 * (common / settings.scale_log_sd) ** 2
    found -= 0.5 * float((((logs - common) / settings.interface_log_sd) ** 2).sum())
    found -= 0.5 * (np.log(length) / settings.length_log_sd) ** 2
    return float(found - 0.5 * (np.log(numerical) / settings.numerical_log_sd) ** 2)


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
