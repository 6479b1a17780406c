"""Estimation of the amplitude and correlation length of the noise from unexplained residuals.

The scales are estimated from the residuals that no constant, nuisance or smooth field explains, as
the fixed point of restricted maximum likelihood, ``s^2 = |e|^2 / tr (I - H)^2`` for each interface,
with H the hat matrix of all these columns (D. A. Harville, J. Am. Stat. Assoc. 72 (1977) 320). This
matches the residuals e to their expectation under noise alone, so a strong effect is not mistaken
for noise. A thousand residuals determine a scale to within a few per cent, so it is fixed at its
optimum.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.special import logsumexp

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.diagnosis.noise.model import NoiseParts, NoiseState, weighted_sum
from palpate.workers.diagnosis.settings.values import SETTINGS


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
    found: list[tuple[float, NoiseState]] = []
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
            found.append((value, NoiseState(n, scales, numerical, prior)))
    found.sort(key=lambda one: -one[0])
    kept = [state for value, state in found if value > found[0][0] - settings.hopeless_nats]
    total = float(logsumexp([state.log_weight for state in kept]))
    shares = np.exp([value - found[0][0] for value, _ in found[: len(kept)]])
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
