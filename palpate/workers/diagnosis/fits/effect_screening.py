r"""Linear screening: what each effect would explain at the nominal fit, without solving again.

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

Whether an effect can be detected at all is computed without the residuals. Columns are whitened and
per prior standard deviation, so that parameters with different units can be added up.

`NominalAnalysis` is the nominal model at its optimum, with the sensitivities of all effects: the
state before any effect is fitted. Quantities needed only by some tasks, such as the smooth field,
are computed on first use.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp, ndtri

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_sensitivities import places_of
from palpate.workers.diagnosis.fits.gauss_newton import Fit, SolvedFit
from palpate.workers.diagnosis.laplace_evidence import Quadratic, log_marginal
from palpate.workers.diagnosis.linearisation import EffectSensitivity, Linearised
from palpate.workers.diagnosis.noise.noise_components import smooth_columns
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.mechanics.effects.effect import Effect

NONCENTRALITY = float(
    (ndtri(1 - SETTINGS.detectability.significance / 2) + ndtri(SETTINGS.detectability.power)) ** 2
)
"""11.7: a two-sided test at the 1 % level detects an effect of this strength with 80 % power."""


INVISIBLE = 1e-6  # share of an effect below which the projected part is only rounding error


def absorbed_share(problem: Linearised, whitened: FloatArray) -> float:
    """Return ``1 - |P B|^2 / |B|^2``, the share of an effect that nominal parameters absorb.

    Parameters
    ----------
    problem : Linearised
    whitened : ndarray, shape (m, q)
        See `EffectSensitivity.whitened`.

    Returns
    -------
    float
        Share from 0 to 1; also 1 for an effect without influence.
    """
    total = float((whitened**2).sum())
    return 1.0 - float((problem.project(whitened) ** 2).sum()) / total if total > 0 else 1.0


def hides(problem: Linearised, whitened: FloatArray) -> bool:
    """Return True if the nominal parameters absorb an effect, or leave too little of it to detect.

    Too little means that, on average over the parameters, the test of `NONCENTRALITY` would miss an
    effect of one prior standard deviation.

    Parameters
    ----------
    problem : Linearised
    whitened : ndarray, shape (m, q)
        See `EffectSensitivity.whitened`.
    """
    share = absorbed_share(problem, whitened)
    left = float((problem.project(whitened) ** 2).sum()) / whitened.shape[1]
    return share > SETTINGS.detectability.sunk_share or (
        share > SETTINGS.detectability.hidden_share and left < NONCENTRALITY
    )


def minimum_detectable(
    problem: Linearised, sensitivity: EffectSensitivity, strength: float = NONCENTRALITY
) -> FloatArray:
    """Return the magnitude at which each parameter alone is as strong as a test needs.

    ``sqrt(strength / B'PB)``, in the units of the parameters; by default, the magnitude detected
    with 80 % power at 1 % false alarms. Its gain in log evidence is half of `strength`.

    Returns
    -------
    ndarray, shape (q,)
        Medians over the places; inf for an invisible parameter.
    """
    information = np.array(
        [(B * problem.project(B)).sum(axis=0) for B in sensitivity.whitened(problem)]
    )
    with np.errstate(divide="ignore"):
        scaled = np.sqrt(strength / np.maximum(information, 0.0))
    return np.median(scaled, axis=0) * sensitivity.prior_sd


def confusion(problem: Linearised, sensitivities: Sequence[EffectSensitivity]) -> FloatArray:
    """Return the largest similarity between the visible parts of each pair of effects.

    It is the largest canonical correlation of the projected columns, the cosine of the smallest
    principal angle (A. Bjorck and G. H. Golub, Math. Comput. 27 (1973) 579); for effects with
    places, the maximum over the places.

    Returns
    -------
    ndarray, shape (effects, effects)
        Similarities from 0 to 1, symmetric, with ones on the diagonal.
    """
    bases = [_bases(problem, sensitivity.whitened(problem)) for sensitivity in sensitivities]
    cosines = np.eye(len(bases))
    for i, first in enumerate(bases):
        for j, second in enumerate(bases[:i]):
            products = np.tensordot(first, second, axes=(1, 1)).transpose(0, 2, 1, 3)
            largest = float(np.linalg.svd(products, compute_uv=False).max())
            cosines[i, j] = cosines[j, i] = min(1.0, largest)
    return cosines


def _bases(problem: Linearised, whitened: FloatArray) -> FloatArray:
    """Return orthonormal bases of the visible part of an effect at g places, shape (g, m, q).

    Columns beyond the rank are zero.
    """
    visible = np.stack([problem.project(B) for B in whitened])
    u, s, _ = np.linalg.svd(visible, full_matrices=False)
    least = INVISIBLE * np.linalg.norm(whitened, axis=(1, 2))[:, None]
    return np.asarray(u * (s > least)[:, None, :])


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
        `workers.diagnosis.fits.effect_screening.hides`.
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
    gradients = whitened.transpose(0, 2, 1) @ problem.efficient_residual
    curvatures = np.stack([B.T @ problem.project(B) for B in whitened])
    # The constant part of the misfit is common to both hypotheses and therefore omitted.
    q = Quadratic(np.zeros(len(whitened)), gradients, curvatures)
    factors = log_marginal(q, nowhere, sensitivity.one_sided)
    best = int(factors.argmax())
    covariance = np.linalg.inv(np.eye(len(nowhere)) + curvatures[best])
    mean = -covariance @ gradients[best]
    return ScreeningResult(
        name=sensitivity.name,
        score=float(-gradients[best] @ mean),
        estimate=mean * sensitivity.prior_sd,
        estimate_sd=np.sqrt(np.diag(covariance)) * sensitivity.prior_sd,
        log_bayes_factor=float(logsumexp(factors) - np.log(len(factors))),
        absorbed=absorbed_share(problem, whitened[best]),
        hides=hides(problem, whitened[best]),
        place=best,
        place_log_bayes_factors=factors,
    )


@dataclass(frozen=True, eq=False)
class NominalAnalysis:
    """The nominal fit with the sensitivities of all effects.

    Parameters
    ----------
    inverse : InverseProblem
        Problem with the points and the noise of the calibration.
    nominal : SolvedFit
        Fit of the constants alone.
    sensitivities : sequence of EffectSensitivity
        Sensitivities to the effects that act on at least one scan and could be simulated.
    """

    inverse: InverseProblem
    nominal: SolvedFit
    sensitivities: Sequence[EffectSensitivity]

    @cached_property
    def linear(self) -> Linearised:
        """Residuals, derivatives and noise around the nominal fit."""
        return self.nominal.linearised(self.inverse)

    @cached_property
    def linear_with_poses(self) -> Linearised:
        """Residuals, derivatives and noise with poses and contour bias as free parameters."""
        return self.nominal.linearised_with_poses(self.inverse)

    @cached_property
    def screening(self) -> tuple[ScreeningResult, ...]:
        """Screening results of single effects, the largest Bayes factor first."""
        return screen(self.linear, self.sensitivities)

    @cached_property
    def log_evidence(self) -> float:
        """Log evidence of the nominal model, in nats."""
        return self.nominal.log_evidence(self.inverse)

    def places(self, effect: Effect) -> FloatArray:
        """Return the places at which an effect was evaluated; see `places_of`."""
        return places_of(self.inverse, effect)

    def is_steep(self, effect: Effect) -> bool:
        """Return True if the response to an effect grows faster than its magnitude.

        The linear model then underestimates a large effect.
        """
        return effect.place is None and self.sensitivity_by_name[effect.name].is_steep

    def field_gain(self, at: Fit) -> float:
        """Return the gain in log evidence of a fit from a smooth field for unlisted causes.

        It is averaged over the lengths and amplitudes of the field's prior; zero without a field.
        """
        amplitudes_mm = self.inverse.something_else.amplitudes_mm
        without = at.log_evidence(self.inverse)
        with_field = [
            at.log_evidence(self.inverse, amplitude * columns)
            for columns in self.fields
            for amplitude in amplitudes_mm
        ]
        return float(logsumexp(with_field) - np.log(len(with_field))) - without

    @cached_property
    def fields(self) -> tuple[FloatArray, ...]:
        """Columns of a smooth field of unit amplitude, (m, r) in mm, for each length."""
        lengths = self.inverse.something_else.lengths_mm
        return tuple(self._smooth_columns(length) for length in lengths)

    @property
    def field(self) -> FloatArray:
        """Columns of a smooth field of medium amplitude and length, shape (m, r), in mm."""
        prior = self.inverse.something_else
        return prior.middle_amplitude_mm * self._smooth_columns(prior.middle_length_mm)

    def _smooth_columns(self, length_mm: float) -> FloatArray:
        inverse = self.inverse
        normals = np.concatenate([scan.normals for scan in self.nominal.predictions])
        return smooth_columns(
            np.tile(inverse.points.points, (len(inverse.scans), 1)),
            normals,
            inverse.rows,
            np.ones(len(normals)),
            length_mm,
            inverse.something_else.state_correlation.between(inverse.directions),
            SETTINGS.smooth_field.rank_tolerance,
        )

    @property
    def sensitivity_by_name(self) -> dict[str, EffectSensitivity]:
        """Sensitivities by name of the effect."""
        return {one.name: one for one in self.sensitivities}

    @property
    def screening_by_name(self) -> dict[str, ScreeningResult]:
        """Results of the screening by name of the effect."""
        return {one.name: one for one in self.screening}

    @property
    def hidden(self) -> set[str]:
        """Effects that the constants hide."""
        return {one.name for one in self.screening if one.hides}
