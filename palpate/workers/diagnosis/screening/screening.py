r"""Linear screening: the support of the residuals for each effect, without solving again.

For an effect with columns B (whitened) and prior covariance S, and the efficient
residual P rho of `Linearised`:

.. math:: g = B'P\rho, \quad H = B'PB + S^{-1}, \quad T = g'H^{-1}g, \quad
          \hat\varphi = -H^{-1}g, \quad
          \ln BF = \tfrac12 T - \tfrac12\ln|H| - \tfrac12\ln|S|.

T is Rao's score with a prior, the modification index of structural equation models; the estimate is
the expected parameter change (W. E. Saris, A. Satorra and W. M. van der Veld, Struct. Equ. Modeling
16 (2009) 561). A half-normal prior multiplies the Bayes factor by Phi(estimate / sd) / 0.5. The
Bayes factor of an effect with many possible places is averaged over them, which corrects for having
tried many.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.algebra.evidence import Quadratic, log_marginal, posterior
from palpate.workers.diagnosis.algebra.linearisation import Linearised
from palpate.workers.diagnosis.screening.detectability import absorbed_share, hides


@dataclass(frozen=True, slots=True, eq=False)
class ScreeningResult:
    """Screening result of one effect.

    Parameters
    ----------
    name : str
    score : float
        Score T, at the best place.
    estimate, estimate_sd : ndarray, shape (q,)
        Expected parameters and their standard deviations at the best place, in their units. The
        estimate of a one-sided parameter may be negative if the data favour the opposite sign.
    log_bayes_factor : float
        Log Bayes factor against the effect being absent, in nats; averaged over the places.
    absorbed : float
        Share of the effect that the nominal parameters absorb, 0 to 1; at the best place.
    hides : bool
        Whether they hide all of the effect that the data could show; see
        `workers.diagnosis.screening.detectability.hides`.
    place : int
        Index of the best place, or of the best magnitude if several are tried; otherwise 0.
    place_log_bayes_factors : ndarray, shape (g,)
        Log Bayes factor for each place or magnitude.
    """

    name: str
    score: float
    estimate: FloatArray
    estimate_sd: FloatArray
    log_bayes_factor: float
    absorbed: float
    hides: bool
    place: int
    place_log_bayes_factors: FloatArray


def screen(
    problem: Linearised, sensitivities: Sequence[EffectSensitivity]
) -> tuple[ScreeningResult, ...]:
    """Screen every effect separately.

    Parameters
    ----------
    problem : Linearised
        Linearisation at the fit of the nominal parameters.
    sensitivities : sequence of EffectSensitivity

    Returns
    -------
    tuple of ScreeningResult
        Results, the largest Bayes factor first.

    Raises
    ------
    InputError
        If a sensitivity has a different number of residuals.
    """
    screening = [_look_at(problem, sensitivity) for sensitivity in sensitivities]
    return tuple(sorted(screening, key=lambda result: -result.log_bayes_factor))


def _look_at(problem: Linearised, sensitivity: EffectSensitivity) -> ScreeningResult:
    whitened = sensitivity.whitened(problem)
    nowhere = np.zeros(len(sensitivity.prior_sd))
    q = Quadratic.stacked([_efficient(problem, B) for B in whitened])
    factors = log_marginal(q, nowhere, sensitivity.one_sided)
    best = int(factors.argmax())
    means, covariances = posterior(q, nowhere)
    mean, covariance = means[best], covariances[best]
    return ScreeningResult(
        name=sensitivity.name,
        score=float(-q.gradient[best] @ mean),
        estimate=mean * sensitivity.prior_sd,
        estimate_sd=np.sqrt(np.diag(covariance)) * sensitivity.prior_sd,
        log_bayes_factor=float(logsumexp(factors) - np.log(len(factors))),
        absorbed=absorbed_share(problem, whitened[best]),
        hides=hides(problem, whitened[best]),
        place=best,
        place_log_bayes_factors=factors,
    )


def _efficient(problem: Linearised, B: FloatArray) -> Quadratic:
    """Return the misfit as a function of the effect alone, integrating out nominal parameters.

    The constant part is common to both hypotheses and therefore omitted.
    """
    gradient = B.T @ problem.efficient_residual
    return Quadratic(np.zeros(()), gradient, B.T @ problem.project(B), np.zeros(()))
