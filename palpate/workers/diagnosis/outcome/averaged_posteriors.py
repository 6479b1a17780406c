"""Posteriors of parameters and gaps, averaged over uncertain noise, poses and causes.

**Parameters.** A fit assumes one noise state and the given prior for the poses. If the actual pose
errors are smaller, the fit underestimates an effect that moves the body as a pose does. The mean
for each noise state and pose scale is one Newton step away; the means are weighted by their
evidence.

**Gaps.** A hypothesis predicts the position of the body: the interfaces of its fit, with a normal
posterior over its constants and effects, their form errors and, if included, a smooth field. The
distance of another model from that position is the error of that model if the hypothesis is true.
Drawn in proportion to the probabilities of the hypotheses, and over the possible noise, these
distances are the posterior of the gap (J. A. Hoeting et al., Stat. Sci. 14 (1999) 382). An
uncertain cause therefore contributes only in proportion to its probability. Poses of the scans and
the bias of their contours are integrated out and do not count as a gap.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis
from palpate.workers.diagnosis.fits.gauss_newton import Fit
from palpate.workers.diagnosis.fits.model_errors import log_prior_of_sizes
from palpate.workers.diagnosis.laplace_evidence import Quadratic, Sides, posterior
from palpate.workers.diagnosis.noise.averaged_evidence import (
    LinearHypothesis,
    NoiseModel,
    with_pose_scales,
)
from palpate.workers.diagnosis.outcome.gap_and_shrinkage import parts_of_floor
from palpate.workers.diagnosis.problem.inverse_problem import Unknowns
from palpate.workers.diagnosis.verdict.hypotheses import Case


class ParameterPosterior(NamedTuple):
    """Mean and standard deviation of each unknown of a fit, shape (p,)."""

    mean: FloatArray
    sd: FloatArray


def parameter_posterior(noise: NoiseModel, at: LinearHypothesis, u: Unknowns) -> ParameterPosterior:
    """Return the posterior of the unknowns of a fit, given its linearisation `at`.

    The means are clipped to the bounds.
    """
    p = len(u.sd)
    q = with_pose_scales(noise.plain(noise.products(at.columns, at.residual)), at.is_pose)
    weights = softmax(at.log_marginal(q)).ravel()
    means, covariances = posterior(q, at.offset)
    means = means[..., :p].reshape(-1, p)
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)[..., :p].reshape(-1, p)
    mean = weights @ means
    sd = np.sqrt(weights @ (variances + (means - mean) ** 2)) * u.sd
    z = np.clip(u.mean + mean * u.sd, u.lower, u.upper)
    return ParameterPosterior(np.asarray(z), np.asarray(sd))


@dataclass(frozen=True, eq=False)
class GapDraws:
    """Distances of models from the body on its interfaces, drawn from their posterior.

    Parameters
    ----------
    before : ndarray, shape (m, n)
        Signed distances of the nominal model in mm, for each residual and draw.
    after : ndarray, shape (m, n), or None
        Signed distances of the model with the named effects; None if there are none.
    floors_mm : ndarray, shape (n,)
        Draws of the errors common to all models.
    """

    before: FloatArray
    after: FloatArray | None
    floors_mm: FloatArray

    @property
    def before_mm(self) -> FloatArray:
        """Root mean square distance of the nominal model in each draw, shape (n,)."""
        return self._root_mean_square(self.before)

    @property
    def after_mm(self) -> FloatArray | None:
        """Root mean square distance with the named effects in each draw, shape (n,)."""
        return None if self.after is None else self._root_mean_square(self.after)

    def _root_mean_square(self, distances: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt((distances**2).mean(axis=0) + self.floors_mm**2))


def draw_gaps(
    analysis: NominalAnalysis,
    fits: Mapping[tuple[str, ...], Fit],
    probabilities: Mapping[Case, float],
    named: Fit | None,
    floor_mm: float,
) -> GapDraws:
    """Draw distances from the body of the nominal model and of a model with the named effects.

    Parameters
    ----------
    analysis : NominalAnalysis
    fits : mapping of tuple of str to Fit
        Joint fits of effects and constants.
    probabilities : mapping of Case to float
        Probability of each hypothesis. A hypothesis whose effects were not fitted counts as a
        smooth field or, if the constants hide the effects, as the nominal model.
    named : Fit or None
        The one of `fits` with the named effects.
    floor_mm : float
        Error common to all models, due to the mesh and the segmentation of the body.
    """
    settings = SETTINGS.gap
    rng = np.random.default_rng(settings.seed)
    known = {(): analysis.nominal, **fits}
    weights = _of_fitted(probabilities, known, analysis.hidden, analysis.noise.has_field)
    counts = _shared_out(settings.draws, np.array(list(weights.values())))
    models = [analysis.nominal] + ([] if named is None else [named])
    residuals, place = [m.residual(analysis.inverse) for m in models], analysis.inverse.is_place
    drawn: list[list[FloatArray]] = [[] for _ in models]
    for (names, field), count in zip(weights, counts, strict=True):
        if not count:
            continue
        true = _Beliefs(analysis, known[names], bool(names), field).draw(count, rng)
        for own, residual in zip(drawn, residuals, strict=True):
            own.append((residual[:, None] - true)[place])
    floors = floor_mm * parts_of_floor(rng, settings.draws)
    each = [np.hstack(parts) for parts in drawn]
    return GapDraws(each[0], each[1] if named is not None else None, floors)


def _of_fitted(
    probabilities: Mapping[Case, float],
    known: Mapping[tuple[str, ...], Fit],
    hidden: set[str],
    has_field: bool,
) -> dict[Case, float]:
    """Return the probabilities of the fitted hypotheses, omitting improbable ones."""
    totals: dict[Case, float] = {}
    for (names, field), probability in probabilities.items():
        stands = (names, field)
        if names not in known:
            stands = ((), has_field and not set(names) <= hidden)
        totals[stands] = totals.get(stands, 0.0) + probability
    heard = {case: value for case, value in totals.items() if value >= SETTINGS.gap.heard}
    return {case: value / sum(heard.values()) for case, value in heard.items()}


def _shared_out(draws: int, weights: FloatArray) -> list[int]:
    """Split the draws in proportion to the weights, rounded so as to preserve their sum."""
    ends = np.rint(draws * np.cumsum(weights) / weights.sum()).astype(int)
    return np.diff(ends, prepend=0).tolist()


class _Beliefs:
    """Position of the body under a hypothesis, as the residuals of a model at that position.

    It is a mixture of normal distributions over noise states, pose scales, sizes of the form
    errors, and lengths and amplitudes of a smooth field.
    """

    def __init__(self, analysis: NominalAnalysis, at: Fit, acts: bool, field: bool) -> None:
        noise, hypothesis = analysis.coarse_noise, analysis.hypothesis(at)
        errors = analysis.errors_of_form(hypothesis) if acts else _nothing_of(hypothesis)
        fields = analysis.fields if field else (_nothing_of(hypothesis),)
        self._parts: list[_Part] = []
        for columns in fields:
            wide = hypothesis.with_errors(errors).with_errors(columns)
            states = noise.likeliest if field else noise.states
            q = noise.plain(noise.products(wide.columns, wide.residual), states)
            for log_prior, factors in _sizes(wide, errors, columns, noise.amplitudes_mm):
                scaled = with_pose_scales(q.scaled(factors), wide.is_pose)
                logs = log_prior + wide.log_marginal(scaled)
                self._parts.append(_Part(wide, scaled, factors, logs.ravel()))

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw residuals of a model that coincides with the body, shape (m, count), in mm."""
        chances = softmax(np.concatenate([part.logs for part in self._parts]))
        counts = rng.multinomial(count, chances)
        ends = np.cumsum([len(part.logs) for part in self._parts])
        own = zip(self._parts, np.split(counts, ends[:-1]), strict=True)
        return np.hstack([part.draw(n, c, rng) for part, each in own for n, c in _some(each)])


@dataclass(frozen=True, eq=False)
class _Part:
    """Normal distributions with the same columns, scaled by factors of shape (p,)."""

    at: LinearHypothesis
    q: Quadratic
    factors: FloatArray
    logs: FloatArray

    def draw(self, which: int, count: int, rng: np.random.Generator) -> FloatArray:
        """Return `count` draws of one distribution without the poses, shape (m, count)."""
        p, offset = len(self.factors), self.at.offset
        quadratic = Quadratic(
            self.q.misfit.ravel()[which],
            self.q.gradient.reshape(-1, p)[which],
            self.q.curvature.reshape(-1, p, p)[which],
            self.q.log_determinant.ravel()[which],
        )
        mean, covariance = posterior(quadratic, offset)
        spread = np.linalg.cholesky(covariance) @ rng.standard_normal((p, count))
        z = _within_bounds(mean[:, None] + spread, covariance, self.at.sides)
        step = (self.factors[:, None] * (z - offset[:, None]))[~self.at.is_pose]
        return self.at.residual[:, None] + self.at.columns[:, ~self.at.is_pose] @ step


def _within_bounds(z: FloatArray, covariance: FloatArray, within: Sides) -> FloatArray:
    """Move each parameter of the draws (p, n), in turn, back to its bound if it is beyond.

    The other parameters move to their conditional means, to preserve their correlation. A
    parameter that a later move pushes slightly beyond its bound stays there.
    """
    for j in np.flatnonzero(within.side):
        inward = within.side[j]
        short = inward * np.maximum(inward * (within.edge[j] - z[j]), 0.0)
        z = z + np.outer(covariance[:, j] / covariance[j, j], short)
    return z


def _sizes(
    wide: LinearHypothesis, errors: FloatArray, field: FloatArray, amplitudes_mm: Sequence[float]
) -> Iterator[tuple[float, FloatArray]]:
    """Yield the log prior and the factors (p,) of each size of form errors and field."""
    e, f, p = errors.shape[1], field.shape[1], wide.columns.shape[1]
    of_errors = zip(SETTINGS.form.relative_sds, log_prior_of_sizes(), strict=True)
    for size, log_prior in of_errors if e else [(1.0, 0.0)]:
        for amplitude in amplitudes_mm if f else [1.0]:
            yield log_prior, np.repeat([1.0, size, amplitude], [p - e - f, e, f])


def _some(counts: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Yield the index and value of each nonzero count."""
    return ((n, int(count)) for n, count in enumerate(counts) if count)


def _nothing_of(hypothesis: LinearHypothesis) -> FloatArray:
    return np.zeros((len(hypothesis.residual), 0))
