r"""Evidence for hypotheses, averaged over uncertain noise.

No model of a body is exact: another solver, mesh or contact model differs from it by more than the
noise of an image. So the parameters of a hypothesis h have the coarsened posterior of J. W. Miller
and D. B. Dunson (JASA 114 (2019) 1113): the likelihood under the segmentation noise is raised to a
power zeta, as if that noise were 1 / sqrt(zeta) times as large. Hypotheses are weighed by their
evidence to the same power,

.. math:: p(h | d) \propto p(h) \left( \int p(d | \theta, h) \, p(\theta | h) \, d\theta
    \right)^\zeta,

so that the penalty for each parameter is scaled together with the gain from it. With zeta inside
the integral, effects with many parameters, such as an inclusion, would be penalised too strongly.

The given covariance is block-diagonal in the interfaces. One Cholesky factor for each correlation
length whitens everything; scales, the numerical error and a smooth field only add systems as large
as their number of columns.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import logsumexp

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.laplace_evidence import Quadratic, Sides, log_marginal, sides
from palpate.workers.diagnosis.noise.noise_components import NoiseParts, NoiseState, weighted_sum


class _Whitened:
    """Columns in the space where the given noise is white, with inner products by group."""

    def __init__(self, factor: FloatArray, masks: Sequence[FloatArray], columns: FloatArray):
        self.columns = np.asarray(solve_triangular(factor, columns, lower=True, check_finite=False))
        self.parts = [self.columns[mask] for mask in masks]

    def gram(self, other: "_Whitened") -> list[FloatArray]:
        """Return ``own' other`` for each group."""
        return [a.T @ b for a, b in zip(self.parts, other.parts, strict=True)]


@dataclass(frozen=True, eq=False)
class LinearHypothesis:
    """The model around a fit of some effects.

    Parameters
    ----------
    residual : ndarray, shape (m,)
        Residuals in mm.
    columns : ndarray, shape (m, p)
        Derivatives per prior standard deviation.
    offset : ndarray, shape (p,)
        Fit minus prior mean, in prior standard deviations.
    one_sided : ndarray of bool, shape (p,)
    is_pose : ndarray of bool, shape (p,)
        Whether a column is a motion of a scan; its prior deviation is averaged over.
    at_bound : ndarray of int, shape (p,), optional
        Bounds at which parameters were stopped; see `laplace_evidence.log_marginal`.
    """

    residual: FloatArray
    columns: FloatArray
    offset: FloatArray
    one_sided: BoolArray
    is_pose: BoolArray
    at_bound: IntArray | None = None

    @property
    def sides(self) -> Sides:
        """Bounds of the parameters, and the side on which each parameter must be."""
        return sides(self.offset, self.one_sided, self.at_bound)

    def log_marginal(self, q: Quadratic) -> FloatArray:
        """Return the log evidence of each misfit in a stack, shape (...)."""
        return log_marginal(q, self.offset, self.one_sided, self.at_bound)

    def with_errors(self, columns: FloatArray, *, are_poses: bool = False) -> "LinearHypothesis":
        """Return the hypothesis with further columns of unit deviation, shape (m, q)."""
        q = columns.shape[1]
        return LinearHypothesis(
            self.residual,
            np.hstack([self.columns, columns]),
            np.append(self.offset, np.zeros(q)),
            np.append(self.one_sided, np.zeros(q, np.bool_)),
            np.append(self.is_pose, np.full(q, are_poses)),
            None if self.at_bound is None else np.append(self.at_bound, np.zeros(q, np.int32)),
        )


def with_pose_scales(q: Quadratic, is_pose: BoolArray) -> Quadratic:
    """Return misfits for several prior scales of the poses: the given scale and smaller ones.

    Residuals determine the poses far better than the prior does, so poses cost every hypothesis the
    same, whether needed or not. If the headers of the scans are accurate, effects that move the
    body as poses do would then be missed; see
    `workers.diagnosis.diagnosis_settings.PoseSettings.scales`.
    """
    if not is_pose.any():
        return q
    scales = SETTINGS.pose.scales
    either = Quadratic.stacked([q.scaled(np.where(is_pose, scale, 1.0)) for scale in scales])
    share = 2.0 * np.log(len(scales))
    return either._replace(log_determinant=either.log_determinant + share)


def _joined(q: Quadratic, at: LinearHypothesis) -> float:
    """Return the log evidence, averaged over noise states and pose scales."""
    return float(logsumexp(at.log_marginal(with_pose_scales(q, at.is_pose))))


class NoiseModel:
    """The uncertain noise of one diagnosis, over which evidence is averaged.

    Parameters
    ----------
    parts : NoiseParts
    states : sequence of NoiseState
        See `learnt_states`.
    fields : sequence of ndarray, shape (m, r)
        Columns of a smooth field of unit amplitude, for each of its lengths.
    amplitudes_mm : sequence of float
        Amplitudes of the field; all combinations of length and amplitude are equally probable.
    """

    def __init__(
        self,
        parts: NoiseParts,
        states: Sequence[NoiseState],
        fields: Sequence[FloatArray] = (),
        amplitudes_mm: Sequence[float] = SETTINGS.smooth_field.amplitudes_mm,
    ) -> None:
        self._power = 1.0
        self.parts, self.states, self.amplitudes_mm = parts, tuple(states), tuple(amplitudes_mm)
        self.size = parts.size
        self._masks = [parts.groups == g for g in range(int(parts.groups.max()) + 1)]
        self._counts = np.array([mask.sum() for mask in self._masks])
        self._factors = {
            n: np.asarray(cholesky(parts.stated[n], lower=True, check_finite=False))
            for n in {state.length for state in states}
        }
        both = np.hstack([parts.fixed, parts.numerical])
        self.nuisances = {n: self.white(n, both) for n in self._factors}
        self._own = {n: white.gram(white) for n, white in self.nuisances.items()}
        self._fields = {
            n: [self.white(n, f) for f in fields] for n in {s.length for s in self.likeliest}
        }
        self._n_fields = len(fields)
        self._systems: dict[int, FloatArray] = {}
        self._field_systems: dict[tuple[int, int, float], FloatArray] = {}

    def coarsened(self, power: float) -> "NoiseModel":
        """Return this noise with the likelihood raised to a power."""
        found = copy(self)
        found._power, found._systems, found._field_systems = power, {}, {}
        return found

    @property
    def likeliest(self) -> tuple[NoiseState, ...]:
        """The noise states for which a smooth field is evaluated."""
        return self.states[: SETTINGS.noise.field_states]

    def products(self, columns: FloatArray, residual: FloatArray) -> "Products":
        """Return the inner products of a hypothesis for `plain` and `with_field`.

        Parameters
        ----------
        columns : ndarray, shape (m, p)
            Derivatives of the residuals per prior standard deviation, in mm.
        residual : ndarray, shape (m,)
            Residuals in mm.
        """
        return Products(self, np.column_stack([columns, residual]))

    def plain(self, products: "Products", states: Sequence[NoiseState] | None = None) -> Quadratic:
        """Return the misfit under every state of the noise, as a stack.

        The determinants include the weights of the states, so that logsumexp combines the log
        evidences of a hypothesis.

        Parameters
        ----------
        products : Products
        states : sequence of NoiseState, optional
            A subset of the states; all by default.
        """
        found = []
        for state in self.states if states is None else states:
            _, own, cross = products.under(state.length)
            weights = self._weights(state)
            X = self._scale(state)[:, None] * weighted_sum(weights, cross)
            factor = self._system(state)
            found.append(self._quadratic(state, weighted_sum(weights, own), factor, X))
        return Quadratic.stacked(found)

    def with_field(self, products: "Products") -> Quadratic:
        """Return the misfit with a smooth field in the noise, under the likeliest states.

        See `plain`. Omitted states are compensated for by their share when the noise was learnt,
        which also included a smooth field.
        """
        share = np.log(max(1, self._n_fields) * len(self.amplitudes_mm))
        share += np.log(sum(state.share for state in self.likeliest))
        misfits = []
        for state in self.likeliest:
            white, own, cross = products.under(state.length)
            weights = self._weights(state)
            inner = weighted_sum(weights, own)
            X = self._scale(state)[:, None] * weighted_sum(weights, cross)
            for f, field in enumerate(self._fields[state.length]):
                F = weighted_sum(weights, field.gram(white))
                for amplitude in self.amplitudes_mm:
                    factor = self._field_system(state, f, amplitude)
                    q = self._quadratic(state, inner, factor, np.vstack([X, amplitude * F]))
                    misfits.append(q._replace(log_determinant=q.log_determinant + 2.0 * share))
        return Quadratic.stacked(misfits)

    def log_evidence(
        self, at: LinearHypothesis, states: Sequence[NoiseState] | None = None
    ) -> float:
        """Return the log evidence of a hypothesis, averaged over the noise states."""
        return _joined(self.plain(self.products(at.columns, at.residual), states), at)

    def log_evidences_with_errors(
        self, at: LinearHypothesis, errors: FloatArray, sizes: Sequence[float]
    ) -> tuple[list[float], list[float] | None]:
        """Return the log evidences of a hypothesis with errors of several sizes.

        Parameters
        ----------
        at : LinearHypothesis
        errors : ndarray, shape (m, q)
            Columns of unit deviation for errors of size one.
        sizes : sequence of float

        Returns
        -------
        list of float, list of float or None
            Log evidences without and with a smooth field in the noise; None if no field can be
            tried.
        """
        wide = at.with_errors(errors)
        products = self.products(wide.columns, wide.residual)
        is_error = np.arange(wide.columns.shape[1]) >= at.columns.shape[1]

        def each(q: Quadratic) -> list[float]:
            return [_joined(q.scaled(np.where(is_error, size, 1.0)), wide) for size in sizes]

        beside = each(self.with_field(products)) if self.has_field else None
        return each(self.plain(products)), beside

    def field_gain(self, at: LinearHypothesis) -> float | None:
        """Return the gain in log evidence from a smooth field; None without one."""
        if not self.has_field:
            return None
        products = self.products(at.columns, at.residual)
        return _joined(self.with_field(products), at) - _joined(self.plain(products), at)

    @property
    def has_field(self) -> bool:
        """Whether a smooth field can be tried."""
        return self._n_fields > 0

    def _quadratic(
        self, state: NoiseState, own: FloatArray, factor: FloatArray, X: FloatArray
    ) -> Quadratic:
        """Return the misfit from the products of all columns, the last of which is the residual."""
        Y = solve_triangular(factor, X, lower=True, check_finite=False)
        left = own - Y.T @ Y
        return Quadratic(
            left[-1, -1],
            left[:-1, -1],
            left[:-1, :-1],
            np.array(self._log_determinant(state, factor) - 2.0 * state.log_weight),
        )

    def _log_determinant(self, state: NoiseState, factor: FloatArray) -> float:
        stated = float(np.log(np.diag(self._factors[state.length])).sum())
        segmentation = stated + float(self._counts @ np.log(state.scales))
        return 2.0 * (self._power * segmentation + float(np.log(np.diag(factor)).sum()))

    def white(self, length: int, columns: FloatArray) -> _Whitened:
        """Return columns in the space where noise of one correlation length is white."""
        return _Whitened(self._factors[length], self._masks, columns)

    def _weights(self, state: NoiseState) -> FloatArray:
        """Return the ratio of coarsened to given precision of each group, shape (groups,)."""
        return np.asarray(self._power / state.scales**2)

    def _scale(self, state: NoiseState) -> FloatArray:
        fixed, numerical = self.parts.fixed.shape[1], self.parts.numerical.shape[1]
        return np.repeat([1.0, state.numerical], [fixed, numerical])

    def _system(self, state: NoiseState) -> FloatArray:
        found = self._systems.get(id(state))
        if found is None:
            d = self._scale(state)
            gram = weighted_sum(self._weights(state), self._own[state.length])
            found = cholesky(np.eye(len(d)) + d[:, None] * gram * d, lower=True)
            self._systems[id(state)] = found
        return found

    def _field_system(self, state: NoiseState, f: int, amplitude: float) -> FloatArray:
        key = (id(state), f, amplitude)
        system = self._field_systems.get(key)
        if system is None:
            weights, d = self._weights(state), self._scale(state)
            field, nuisances = self._fields[state.length][f], self.nuisances[state.length]
            top = self._system(state)
            cross = d[:, None] * weighted_sum(weights, nuisances.gram(field)) * amplitude
            below = np.asarray(weighted_sum(weights, field.gram(field))) * amplitude**2
            side = solve_triangular(top, cross, lower=True, check_finite=False)
            corner = cholesky(np.eye(len(below)) + below - side.T @ side, lower=True)
            n, r = top.shape[0], len(corner)
            system = np.zeros((n + r, n + r))
            system[:n, :n], system[n:, :n], system[n:, n:] = top, side.T, corner
            self._field_systems[key] = system
        return system


class Products:
    """Inner products of the columns of a hypothesis, cached for each correlation length.

    Parameters
    ----------
    noise : NoiseModel
    columns : ndarray, shape (m, p + 1)
        Columns, the last of which is the residual.
    """

    def __init__(self, noise: NoiseModel, columns: FloatArray) -> None:
        self._noise, self._columns = noise, columns
        self._found: dict[int, tuple[_Whitened, list[FloatArray], list[FloatArray]]] = {}

    def under(self, length: int) -> tuple[_Whitened, list[FloatArray], list[FloatArray]]:
        """Return the whitened columns, and their products with each other and with nuisances."""
        found = self._found.get(length)
        if found is None:
            white = self._noise.white(length, self._columns)
            found = white, white.gram(white), self._noise.nuisances[length].gram(white)
            self._found[length] = found
        return found
