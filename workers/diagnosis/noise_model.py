r"""Noise that is learnt: how large and how smooth, beside poses, drawing and numerical errors.

The covariance of the residuals is

.. math:: C = S C_0(l) S + N N' + \tau^2 M M',

with the covariance C_0 that the case states, of correlation length l; scales S of the segmentation,
one for each interface; N the columns of `workers.diagnosis.nuisances` for poses and drawing, and M
those of the numerical error. Scales, l and tau have priors around what is stated or believed, and
enter the evidence of every hypothesis; l and tau are averaged over there.

The scales come from what no constant, no nuisance and no smooth field explains: the fixed point of
restricted maximum likelihood, ``s^2 = |e|^2 / tr (I - H)^2`` for each interface, with H the hat
matrix of all these columns (D. A. Harville, J. Am. Stat. Assoc. 72 (1977) 320): what is expected
of the residuals e if nothing but noise is there. A strong effect therefore does not read as noise.
A thousand residuals know a scale to a few per cent, so it stays there.

C_0 factors interface by interface. One Cholesky factor for each length whitens everything; scales,
tau and a smooth field on top cost systems of the size of their columns.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import logsumexp

from storage.errors import InputError
from storage.values import BoolArray, FloatArray, IntArray
from workers.diagnosis.evidence import Quadratic, log_marginal
from workers.diagnosis.settings import SETTINGS


@dataclass(frozen=True, eq=False)
class NoiseParts:
    """What the noise of the residuals is made of.

    Parameters
    ----------
    stated : tuple of ndarray, shape (m, m)
        Covariance of the segmentation for each correlation length; residuals of different
        groups do not correlate.
    lengths : tuple of float
        These lengths over the stated one.
    groups : ndarray of int, shape (m,)
        Residuals that share a scale: of one interface.
    fixed : ndarray, shape (m, q)
        Nuisances.
    numerical : ndarray, shape (m, r)
        Numerical error, of the size that is believed.

    Raises
    ------
    InputError
        If shapes disagree.
    """

    stated: tuple[FloatArray, ...]
    lengths: tuple[float, ...]
    groups: IntArray
    fixed: FloatArray
    numerical: FloatArray

    def __post_init__(self) -> None:
        m = len(self.groups)
        shapes = {one.shape for one in self.stated} | {(m, len(self.numerical))}
        if shapes != {(m, m)} or len(self.fixed) != m or len(self.lengths) != len(self.stated):
            raise InputError(
                f"The noise of {m} residuals needs covariances ({m}, {m}), one for each length, "
                f"and columns of {m} rows; found {shapes}, {len(self.lengths)} lengths and "
                f"{len(self.fixed)} rows."
            )

    @property
    def size(self) -> int:
        """Number of residuals m."""
        return len(self.groups)

    def scatter(self, length: int, scales: FloatArray, numerical: float) -> FloatArray:
        """Return the covariance of segmentation and numerical error, shape (m, m)."""
        s = scales[self.groups]
        found = self.stated[length] * s[:, None] * s
        return np.asarray(found + numerical**2 * self.numerical @ self.numerical.T)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseState:
    """One point of the average.

    Parameters
    ----------
    length : int
        Number of the correlation length.
    scales : ndarray, shape (groups,)
        Of the segmentation's standard deviation, over what is stated.
    numerical : float
        Of the numerical error, over what is believed.
    log_weight : float
        Logarithm of its prior.
    share : float
        Its probability, of all states, when the noise was learnt.
    """

    length: int
    scales: FloatArray
    numerical: float
    log_weight: float
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class LearntNoise:
    """The noise of a calibrated problem.

    Parameters
    ----------
    parts : NoiseParts
    states : tuple of NoiseState
        The likeliest first; see `learnt_states`.
    """

    parts: NoiseParts
    states: tuple[NoiseState, ...]

    @property
    def covariance(self) -> FloatArray:
        """Of the residuals in the likeliest state, shape (m, m), in mm^2."""
        return self.scatter + self.parts.fixed @ self.parts.fixed.T

    @property
    def scatter(self) -> FloatArray:
        """The same without the nuisances."""
        best = self.states[0]
        return self.parts.scatter(best.length, best.scales, best.numerical)


class _Whitened:
    """Columns in the space where the stated noise is white, and products by groups."""

    def __init__(self, factor: FloatArray, masks: Sequence[FloatArray], columns: FloatArray):
        self.columns = np.asarray(solve_triangular(factor, columns, lower=True, check_finite=False))
        self.parts = [self.columns[mask] for mask in masks]

    def gram(self, other: "_Whitened") -> list[FloatArray]:
        """Return ``own' other`` of each group."""
        return [a.T @ b for a, b in zip(self.parts, other.parts, strict=True)]


@dataclass(frozen=True, eq=False)
class LinearHypothesis:
    """The model around a fit of some effects.

    Parameters
    ----------
    residual : ndarray, shape (m,)
        In mm.
    columns : ndarray, shape (m, p)
        Derivatives per prior standard deviation.
    offset : ndarray, shape (p,)
        Fit minus prior mean, in prior standard deviations.
    one_sided : ndarray of bool, shape (p,)
    """

    residual: FloatArray
    columns: FloatArray
    offset: FloatArray
    one_sided: BoolArray

    def with_errors(self, columns: FloatArray) -> "LinearHypothesis":
        """Return it with more columns of unit deviation, shape (m, q)."""
        q = columns.shape[1]
        return LinearHypothesis(
            self.residual,
            np.hstack([self.columns, columns]),
            np.append(self.offset, np.zeros(q)),
            np.append(self.one_sided, np.zeros(q, np.bool_)),
        )


class NoiseModel:
    """The noise of one diagnosis, averaged over what is not known of it.

    Parameters
    ----------
    parts : NoiseParts
    states : sequence of NoiseState
        See `learnt_states`.
    fields : sequence of ndarray, shape (m, r)
        A smooth field of unit amplitude for each of its lengths.
    amplitudes_mm : sequence of float
        Of that field; all pairs are equally probable.
    """

    def __init__(
        self,
        parts: NoiseParts,
        states: Sequence[NoiseState],
        fields: Sequence[FloatArray] = (),
        amplitudes_mm: Sequence[float] = SETTINGS.smooth_field.amplitudes_mm,
    ) -> None:
        self.parts, self.states, self.amplitudes_mm = parts, tuple(states), tuple(amplitudes_mm)
        self.size = parts.size
        self._masks = [parts.groups == g for g in range(int(parts.groups.max()) + 1)]
        self._counts = np.array([mask.sum() for mask in self._masks])
        self._factors = {
            n: np.asarray(cholesky(parts.stated[n], lower=True, check_finite=False))
            for n in {state.length for state in states}
        }
        nuisances = np.hstack([parts.fixed, parts.numerical])
        self._nuisances = {n: self._white(n, nuisances) for n in self._factors}
        self._own = {n: white.gram(white) for n, white in self._nuisances.items()}
        self._fields = {
            n: [self._white(n, f) for f in fields] for n in {s.length for s in self.likeliest}
        }
        self._n_fields = len(fields)

    @property
    def likeliest(self) -> tuple[NoiseState, ...]:
        """The states under which a smooth field is weighed."""
        return self.states[: SETTINGS.noise.field_states]

    def plain(
        self,
        columns: FloatArray,
        residuals: FloatArray,
        states: Sequence[NoiseState] | None = None,
    ) -> list[Quadratic]:
        """Return the misfit under every state of the noise.

        Weights of the states are in the determinants, so log evidences of a hypothesis are
        joined by the logarithm of the sum of their exponentials.

        Parameters
        ----------
        columns : ndarray, shape (m, p)
            Derivatives of the residuals per prior standard deviation, in mm.
        residuals : ndarray, shape (m, n)
            In mm.
        states : sequence of NoiseState, optional
            Some of them; all.
        """
        p = columns.shape[1]
        found = []
        for length, some in self._by_length(self.states if states is None else states):
            white = self._white(length, np.hstack([columns, residuals]))
            own, cross = white.gram(white), self._nuisances[length].gram(white)
            for state in some:
                weights = 1.0 / state.scales**2
                factor = self._system(state)
                X = self._scale(state)[:, None] * _sum(weights, cross)
                found.append(self._quadratic(state, p, _sum(weights, own), factor, X))
        return found

    def with_field(self, columns: FloatArray, residuals: FloatArray) -> list[Quadratic]:
        """Return the same with a smooth field in the noise, under the likeliest states.

        See `plain`. The states that are left out are made good for by the share that they had
        when the noise was learnt, with a smooth field then too.
        """
        p = columns.shape[1]
        share = np.log(max(1, self._n_fields) * len(self.amplitudes_mm))
        share += np.log(sum(state.share for state in self.likeliest))
        found = []
        for length, states in self._by_length(self.likeliest):
            white = self._white(length, np.hstack([columns, residuals]))
            own, cross = white.gram(white), self._nuisances[length].gram(white)
            for f, field in enumerate(self._fields[length]):
                across = field.gram(white)
                for state in states:
                    weights = 1.0 / state.scales**2
                    X = self._scale(state)[:, None] * _sum(weights, cross)
                    F = _sum(weights, across)
                    for amplitude in self.amplitudes_mm:
                        factor = self._field_system(state, f, amplitude)
                        both = np.vstack([X, amplitude * F])
                        q = self._quadratic(state, p, _sum(weights, own), factor, both)
                        found.append(q._replace(log_determinant=q.log_determinant + 2.0 * share))
        return found

    def log_evidence(
        self, at: LinearHypothesis, states: Sequence[NoiseState] | None = None
    ) -> float:
        """Return the log evidence of a hypothesis, averaged over the states of the noise."""
        quadratics = self.plain(at.columns, at.residual[:, None], states)
        return float(logsumexp([log_marginal(q, at.offset, at.one_sided)[0] for q in quadratics]))

    def field_gain(self, at: LinearHypothesis) -> float | None:
        """Return by how much a smooth field raises it; None without one."""
        if not self.has_field:
            return None
        quadratics = self.with_field(at.columns, at.residual[:, None])
        found = logsumexp([log_marginal(q, at.offset, at.one_sided)[0] for q in quadratics])
        return float(found) - self.log_evidence(at)

    @property
    def has_field(self) -> bool:
        """Whether a smooth field can be tried."""
        return self._n_fields > 0

    def _quadratic(
        self, state: NoiseState, p: int, own: FloatArray, factor: FloatArray, X: FloatArray
    ) -> Quadratic:
        Y = solve_triangular(factor, X, lower=True, check_finite=False)
        A, rho = Y[:, :p], Y[:, p:]
        return Quadratic(
            np.diag(own)[p:] - (rho**2).sum(axis=0),
            own[:p, p:] - A.T @ rho,
            own[:p, :p] - A.T @ A,
            self._log_determinant(state, factor) - 2.0 * state.log_weight,
        )

    def _log_determinant(self, state: NoiseState, factor: FloatArray) -> float:
        stated = float(np.log(np.diag(self._factors[state.length])).sum())
        return 2.0 * (
            stated
            + float(self._counts @ np.log(state.scales))
            + float(np.log(np.diag(factor)).sum())
        )

    @staticmethod
    def _by_length(states: Sequence[NoiseState]) -> list[tuple[int, list[NoiseState]]]:
        return [
            (length, [state for state in states if state.length == length])
            for length in sorted({state.length for state in states})
        ]

    def _white(self, length: int, columns: FloatArray) -> _Whitened:
        return _Whitened(self._factors[length], self._masks, columns)

    def _scale(self, state: NoiseState) -> FloatArray:
        fixed, numerical = self.parts.fixed.shape[1], self.parts.numerical.shape[1]
        return np.repeat([1.0, state.numerical], [fixed, numerical])

    @cached_property
    def _systems(self) -> dict[int, FloatArray]:
        return {}

    def _system(self, state: NoiseState) -> FloatArray:
        found = self._systems.get(id(state))
        if found is None:
            d = self._scale(state)
            gram = _sum(1.0 / state.scales**2, self._own[state.length])
            found = cholesky(np.eye(len(d)) + d[:, None] * gram * d, lower=True)
            self._systems[id(state)] = found
        return found

    @cached_property
    def _field_systems(self) -> dict[tuple[int, int, float], FloatArray]:
        return {}

    def _field_system(self, state: NoiseState, f: int, amplitude: float) -> FloatArray:
        key = (id(state), f, amplitude)
        found = self._field_systems.get(key)
        if found is None:
            weights, d = 1.0 / state.scales**2, self._scale(state)
            field, nuisances = self._fields[state.length][f], self._nuisances[state.length]
            top = self._system(state)
            cross = d[:, None] * _sum(weights, nuisances.gram(field)) * amplitude
            below = np.asarray(_sum(weights, field.gram(field))) * amplitude**2
            side = solve_triangular(top, cross, lower=True, check_finite=False)
            corner = cholesky(np.eye(len(below)) + below - side.T @ side, lower=True)
            n, r = top.shape[0], len(corner)
            found = np.zeros((n + r, n + r))
            found[:n, :n], found[n:, :n], found[n:, n:] = top, side.T, corner
            self._field_systems[key] = found
        return found


def believed(parts: NoiseParts) -> LearntNoise:
    """Return noise that is known: as stated, and a numerical error of the size believed."""
    scales = np.ones(int(parts.groups.max()) + 1)
    return LearntNoise(parts, (NoiseState(parts.lengths.index(1.0), scales, 1.0, 0.0),))


def learnt_states(
    parts: NoiseParts, columns: FloatArray, residual: FloatArray, field: FloatArray
) -> list[NoiseState]:
    """Return the states of the noise that the average runs over.

    The scales at their optimum for every length and size of the numerical error, the likeliest
    first; states that are hopeless beside it are left out.

    Parameters
    ----------
    parts : NoiseParts
    columns : ndarray, shape (m, p)
        Derivatives of the residuals by the constants, per prior standard deviation.
    residual : ndarray, shape (m,)
    field : ndarray, shape (m, r)
        Of a smooth field of middling amplitude, which takes what may be a gap.
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
    """Return the scale of each group by the fixed point of restricted maximum likelihood.

    The prior of its logarithm enters as some more residuals do.
    The last row and column of the products are the residual's.
    """
    settings = SETTINGS.noise
    for _ in range(settings.scale_iterations):
        weights = 1.0 / scales**2
        H = _sum(weights, grams)
        inverse = np.linalg.inv(np.eye(len(H) - 1) + H[:-1, :-1])
        c = np.append(-inverse @ H[:-1, -1], 1.0)
        hidden = 2.0 * inverse - inverse @ H[:-1, :-1] @ inverse
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


def _log_likelihood(grams: Sequence[FloatArray], counts: IntArray, scales: FloatArray) -> float:
    H = _sum(1.0 / scales**2, grams)
    L = cholesky(np.eye(len(H) - 1) + H[:-1, :-1], lower=True)
    y = solve_triangular(L, H[:-1, -1], lower=True)
    misfit = float(H[-1, -1] - y @ y)
    return -0.5 * misfit - float(counts @ np.log(scales)) - float(np.log(np.diag(L)).sum())


def _log_prior(scales: FloatArray, length: float, numerical: float) -> float:
    """Return that of a state, up to a constant: what all interfaces share, and each its own."""
    settings = SETTINGS.noise
    logs = np.log(scales)
    common = float(logs.mean())
    found = -0.5 * (common / settings.scale_log_sd) ** 2
    found -= 0.5 * float((((logs - common) / settings.interface_log_sd) ** 2).sum())
    found -= 0.5 * (np.log(length) / settings.length_log_sd) ** 2
    return float(found - 0.5 * (np.log(numerical) / settings.numerical_log_sd) ** 2)


def _sum(weights: FloatArray, parts: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(sum(w * part for w, part in zip(weights, parts, strict=True)))
