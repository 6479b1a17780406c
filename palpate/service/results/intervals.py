r"""Intervals of the constants: the local model of the fit, and the errors that widen them.

Errors other than the noise of the image: the best candidate is also evaluated with its derivatives
by the nuisance parameters, and on a mesh of another size. A group b of nuisance parameters,
:math:`b \sim N(0, P)`, shifts the constants by :math:`-A^{-1} B b`, with the blocks A, B and D of
J'J. Its posterior and its log Bayes factor are

.. math:: M = \frac{D - B'A^{-1}B}{s^2} + P^{-1}, \qquad
          \hat b = -M^{-1} \frac{g_b - B'A^{-1}g}{s^2}, \qquad
          \ln K = \tfrac12 \hat b'M\hat b - \tfrac12 \ln |P M|.

The variance of a constant grows by :math:`\hat\delta^2 + \mathrm{var}` of the shift, times the
probability of the group (separate discrepancy model: M. C. Kennedy, A. O'Hagan, J. R. Stat.
Soc. B 63 (2001) 425). A group with decisive support from the residual contradicts the estimate.

The mesh error is estimated by the Gauss step between the two meshes. One shift is a single draw
from a distribution with the same relative width for all constants, so half of its square is
averaged over the constants in units of their noise.

The local model is the least-squares problem near the best candidate. It has the covariance, the
directions and the interval ends; `service.results.identification` has the formulas and what they
mean.

The reported intervals are the central 90 % of the posterior. In the coordinates of the local model
the errors of all sources are normal, with the covariance :math:`\Sigma`. The interval of
coordinate i is :math:`l_i` to :math:`u_i`, which is wider than
:math:`\pm 1.64 \sqrt{\Sigma_{ii}}` if the search is unfinished. The posterior keeps the
correlations and takes its centre and width from the interval:

.. math:: x \sim N(m, D \Sigma D), \qquad m_i = \frac{l_i + u_i}{2}, \qquad
          D_{ii} = \frac{u_i - l_i}{2 \cdot 1.64 \sqrt{\Sigma_{ii}}}.

Draws beyond the admissible values of a constant are clipped, as the intervals are.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.service.number_formatting import share
from palpate.service.results.physical_limits import (
    DEVIATIONS,
    UNSEEN,
    at_bound,
    at_limit,
    limited_reach,
    limited_step,
)
from palpate.service.search.search_interface import FloatArray
from palpate.storage.read_only import ReadOnly, hold_read_only
from palpate.storage.values import FitJson, MeshFit, Prior
from palpate.workers.mechanics.model_parameters import Parameter, Vocabulary
from palpate.workers.organs.organ_protocol import Nuisance

# Prior probability of a group of nuisance parameters, against a correct model.
PRIOR_ODDS = 0.1
# Above this log Bayes factor (150 to 1) a group contradicts the estimates.
DECISIVE = 5.0
# Ratio of the study's mesh error to the step to the other mesh. Meshes of 2,000 and 6,000 nodes
# differ by scatter rather than by a trend; see tests/benchmarks/interval_coverage.py.
MESH_FACTOR = 1.0
IMAGE, MISFIT, MESH = "image", "misfit", "mesh"
IMAGE_AND_PRIOR = "image and prior"


@dataclass(frozen=True)
class LocalProblem(ReadOnly):
    """The least-squares problem of the constants, in the coordinates of `LocalModel`.

    Parameters
    ----------
    names : tuple of str
    scale : ndarray, shape (p,)
        Coordinate units per unit of the fit's parameter.
    root : ndarray, shape (p, k)
        Root of the inverse of J'J, ``root @ root.T``, without unidentified directions.
    gradient : ndarray, shape (p,)
        J'r.
    noise_factor : float
        s.
    """

    names: tuple[str, ...]
    scale: FloatArray
    root: FloatArray
    gradient: FloatArray
    noise_factor: float

    @property
    def inverse(self) -> FloatArray:
        """Return the inverse of J'J, without unidentified directions."""
        return np.asarray(self.root @ self.root.T)


@dataclass(frozen=True)
class ErrorSource(ReadOnly):
    """One source of error.

    Parameters
    ----------
    name : str
        As a noun phrase: ``mesh``, ``the place of the scan``.
    root : ndarray, shape (p, k)
        Root of the covariance of the coordinates, ``root @ root.T``.
    log_bayes_factor : float
        Its support from the residual, in nats; 0 if not computed.
    """

    name: str
    root: FloatArray
    log_bayes_factor: float = 0.0

    @property
    def sd(self) -> FloatArray:
        """Return the standard deviation of each coordinate due to this source, shape (p,)."""
        return np.asarray(np.sqrt((self.root**2).sum(axis=1)))

    def sd_along(self, slope: FloatArray) -> float:
        """Return the standard deviation of a value, given its derivatives in the coordinates."""
        return float(np.linalg.norm(slope @ self.root))

    @property
    def supported(self) -> bool:
        """Return True if the residual decisively supports this source."""
        return self.log_bayes_factor > DECISIVE


def nuisance_sources(
    local: LocalProblem, fit: FitJson, nuisances: Iterable[Nuisance]
) -> list[ErrorSource]:
    """Return a source of error for each group of nuisance parameters in `fit`."""
    groups: dict[str, list[Nuisance]] = {}
    for one in nuisances:
        if one.name in fit["parameters"]:
            groups.setdefault(one.group, []).append(one)
    return [_group(local, fit, name, members) for name, members in groups.items()]


def mesh_source(local: LocalProblem, meshes: Sequence[MeshFit]) -> ErrorSource | None:
    """Return the mesh error from the finest of the other meshes; None without other meshes."""
    if not meshes:
        return None
    finest = max(meshes, key=lambda one: one["nodes"])
    change = _gradient(local, finest["fit"]) - local.gradient
    step = -local.inverse @ change
    pooled = float(step @ np.linalg.pinv(local.inverse) @ step) / len(step)
    parts = np.column_stack([step, np.sqrt(pooled) * local.root])
    return ErrorSource(MESH, MESH_FACTOR * parts / np.sqrt(2))


def _group(
    local: LocalProblem, fit: FitJson, name: str, members: Sequence[Nuisance]
) -> ErrorSource:
    own = [fit["parameters"].index(n) for n in local.names]
    indices = [fit["parameters"].index(nuisance.name) for nuisance in members]
    sd = np.array([nuisance.sd for nuisance in members])
    hessian, gradient = np.asarray(fit["hessian"]), np.asarray(fit["gradient"])
    shared = hessian[np.ix_(own, indices)] * np.outer(local.scale, sd)
    response = local.inverse @ shared
    variance = local.noise_factor**2
    information = hessian[np.ix_(indices, indices)] * np.outer(sd, sd) - shared.T @ response
    precision = np.eye(len(indices)) + information / variance
    pull = (gradient[indices] * sd - response.T @ _gradient(local, fit)) / variance
    mean = -np.linalg.solve(precision, pull)
    gain = -0.5 * float(pull @ mean) - 0.5 * float(np.linalg.slogdet(precision)[1])
    always = any(nuisance.always for nuisance in members)
    # A source that is always possible needs no support; else log(1 + 1/odds) is -log(probability).
    odds = gain + np.log(PRIOR_ODDS)
    probability = 1.0 if always else float(np.exp(-np.logaddexp(0.0, -odds)))
    spread = np.linalg.cholesky(np.linalg.inv(precision))
    parts = np.column_stack([response @ mean, response @ spread])
    return ErrorSource(name, np.sqrt(probability) * parts, gain)


def _gradient(local: LocalProblem, fit: FitJson) -> FloatArray:
    order = [fit["parameters"].index(name) for name in local.names]
    return np.asarray(np.asarray(fit["gradient"], np.float64)[order] * local.scale)


def in_words(errors: Mapping[str, float], estimate: float) -> str:
    """Return the sources of an error as percentages of an estimate, the largest first.

    Sources below a tenth of the largest are omitted.

    Examples
    --------
    >>> in_words({"image": 0.03, "mesh": 0.11, "misfit": 0.002}, 10.0)
    'mesh 1.1 %, image 0.3 %'
    """
    largest = max(errors.values(), default=0.0)
    if not largest or not estimate:
        return ""
    ranked = sorted(errors.items(), key=lambda pair: -pair[1])
    return ", ".join(
        f"{name} {100 * sd / abs(estimate):.2g} %" for name, sd in ranked if sd >= largest / 10
    )


# Above this possible reduction, in units of the noise, a sum of squares is not at its minimum.
MOST_FALL = 9.0
# Constants with a smaller share of a direction are not listed in it.
LEAST_SHARE = 0.15


@dataclass(frozen=True)
class Direction(ReadOnly):
    """A combination of the constants that the image determines independently of the others.

    Parameters
    ----------
    weights : mapping of str to float
        By name, of the logarithms of the constants (or of a constant over its searched interval
        if it may be zero); the largest is 1.
    relative_sd : float or None
        Standard deviation, along the direction, of the constant whose weight is 1; None if the
        direction is not identified.
    words : str
        A description such as ``eta_fat up by 10 % with E_fat down by 3 %, known to 12 %``.
    """

    weights: Mapping[str, float]
    relative_sd: float | None
    words: str


@dataclass(frozen=True)
class RelativeInterval(ReadOnly):
    """The 90 % interval of a value derived from the constants, relative to its best estimate.

    Parameters
    ----------
    lower, upper : float
        Factors by which the estimate is multiplied.
    errors : mapping of str to float
        Relative standard deviation contributed by each source of error.
    """

    lower: float
    upper: float
    errors: Mapping[str, float]


@dataclass(frozen=True)
class OtherProblems(ReadOnly):
    """Other least-squares problems of the best candidate.

    Parameters
    ----------
    nuisances : FitJson or None
        Problem with the nuisance parameters.
    priors : tuple of Nuisance
        Priors of the nuisance parameters.
    meshes : sequence of MeshFit
        Problems on other meshes.
    """

    nuisances: FitJson | None = None
    priors: tuple[Nuisance, ...] = ()
    meshes: Sequence[MeshFit] = ()


@dataclass(frozen=True)
class SearchedConstants(ReadOnly):
    """The searched constants of a study, as needed for an identification.

    Parameters
    ----------
    vocabulary : Vocabulary
        Names and units.
    bounds : mapping of str to (float, float)
        In internal names and units.
    common_scale : tuple of str
        Names of stiffnesses known only up to a common factor; empty if all can be found.
    priors : mapping of str to (float, float)
        Mean and standard deviation of constants with a prior, in internal names and units.
    """

    vocabulary: Vocabulary
    bounds: Mapping[str, tuple[float, float]]
    common_scale: tuple[str, ...] = field(default=())
    priors: Mapping[str, Prior] = field(default_factory=dict)

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by its internal name."""
        return self.vocabulary[name]

    def at_door(self, name: str, value: float) -> float:
        """Convert an internal value to its external unit."""
        return float(self.vocabulary[name].unit.to_door(value))


class LocalModel:
    """The least-squares problem near a candidate, in dimensionless coordinates.

    A coordinate is the logarithm of a constant, or the constant divided by its searched interval.
    """

    def __init__(
        self, fit: FitJson, searched: SearchedConstants, others: OtherProblems | None = None
    ) -> None:
        self.names, self.priors = tuple(fit["parameters"]), searched.priors
        self.values = np.asarray(fit["values"], np.float64)
        self.logarithmic = np.asarray(fit["logarithmic"], bool)
        bounds = np.array([searched.bounds[name] for name in self.names])
        self.bounds = bounds
        span = bounds[:, 1] - bounds[:, 0]
        self.scale = np.where(self.logarithmic, 1.0, span)
        self.information = np.asarray(fit["hessian"], np.float64) * np.outer(self.scale, self.scale)
        gradient = np.asarray(fit["gradient"], np.float64) * self.scale
        self.gradient = gradient
        self.eigenvalues, self.eigenvectors = np.linalg.eigh(self.information)
        self.seen = self.eigenvalues > UNSEEN * max(float(self.eigenvalues[-1]), 1e-300)
        self.limits = [searched.parameter(name).limit for name in self.names]
        self.lowest = self._lowest()
        step, fall = self._best_step()
        self.step = self._limited(step, bounds)
        left = float(fit["cost"]) - fall
        freedom = max(1, int(fit["residuals"]) - len(self.names))
        self.noise_factor = float(np.sqrt(max(1.0, left / freedom)))
        self.covariance = self.noise_factor**2 * self._inverse()
        self.sources = self._sources(others or OtherProblems())
        self.common = np.array([name in searched.common_scale for name in self.names])
        self.unseen_root = self._unseen_root(bounds)
        hold_read_only(self)

    @property
    def correlation(self) -> tuple[tuple[float, ...], ...]:
        """Return the correlation of the errors."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        matrix = np.clip(self.covariance / np.outer(sd, sd), -1.0, 1.0)
        np.fill_diagonal(matrix, 1.0)
        return tuple(tuple(float(v) for v in row) for row in matrix)

    def unseen(self, i: int) -> bool:
        """Return True if a coordinate has a large share in an unidentified direction."""
        return bool((np.abs(self.eigenvectors[i, ~self.seen]) > LEAST_SHARE).any())

    def ends(self, i: int) -> FloatArray:
        """Return the interval of a constant, in internal units."""
        return self.moved(i, np.array(self.coordinate_ends(i)))

    def coordinate_ends(self, i: int) -> tuple[float, float]:
        """Return the interval of a coordinate, relative to the candidate."""
        unseen = float((self.unseen_root[i] ** 2).sum())
        variance = unseen + sum(source.sd[i] ** 2 for source in self.sources)
        down, up = self._reach(np.eye(len(self.names))[i], variance)
        step = float(self.step[i])
        return min(0.0, step) - down, max(0.0, step) + up

    @property
    def error_root(self) -> FloatArray:
        """Return a square root of the covariance of all errors, shape (p, k)."""
        return np.column_stack([*(source.root for source in self.sources), self.unseen_root])

    def relative_interval(
        self,
        slope: Mapping[str, float],
        mesh_shift: float | None = None,
        mesh_sd: float | None = None,
    ) -> RelativeInterval:
        """Return the interval of a value derived from the constants.

        Parameters
        ----------
        slope : mapping of str to float
            Derivatives of the value's logarithm with respect to the logarithms of the constants,
            by internal name; constants that are not searched are left out.
        mesh_shift, mesh_sd : float, optional
            Relative increase of the value due to the mesh, and its standard deviation, if they
            are known better than from the least-squares problem on another mesh.
        """
        by_log = np.array([slope.get(name, 0.0) for name in self.names])
        held = np.where(self.values == 0.0, 1.0, self.values)
        by_coordinate = by_log * np.where(self.logarithmic, 1.0, self.scale / held)
        errors = {source.name: source.sd_along(by_coordinate) for source in self.sources}
        if mesh_sd is not None:
            errors[MESH] = mesh_sd
        unseen = float(((by_coordinate @ self.unseen_root) ** 2).sum())
        down, up = self._reach(by_coordinate, unseen + sum(sd**2 for sd in errors.values()))
        step = float(by_coordinate @ self.step) - (mesh_shift or 0.0)
        low, high = min(0.0, step) - down, max(0.0, step) + up
        return RelativeInterval(
            float(np.exp(max(low, -50.0))), float(np.exp(min(high, 50.0))), errors
        )

    def errors(self, i: int) -> dict[str, float]:
        """Return each source's standard deviation for a constant, in internal units."""
        unit = abs(self.values[i]) if self.logarithmic[i] else self.scale[i]
        return {source.name: float(source.sd[i] * unit) for source in self.sources}

    def prior_share(self, i: int) -> float:
        """Return the share of the information on a constant that its prior contributes, 0 to 1.

        The information is the inverse of the variance; 0 without a prior.
        """
        if self.names[i] not in self.priors or self.unseen(i):
            return 0.0
        _, sd = self.priors[self.names[i]]
        slope = float(self.values[i] if self.logarithmic[i] else self.scale[i]) / sd
        return float(self._inverse()[i, i]) * slope**2

    @property
    def supported(self) -> tuple[str, ...]:
        """Return the sources of error with decisive support from the residual, best first."""
        found = [source for source in self.sources if source.supported]
        return tuple(s.name for s in sorted(found, key=lambda s: -s.log_bayes_factor))

    @property
    def converged(self) -> bool:
        """Return True if the Gauss step is negligible in all constants off their bounds."""
        free = np.array([not self.at_bound(i) for i in range(len(self.names))])
        part, gradient = self.information[np.ix_(free, free)], self.gradient[free]
        if self.is_limited:
            _, fall = limited_step(part, gradient, self.lowest[free])
        else:
            inverse = np.linalg.pinv(part, rcond=UNSEEN, hermitian=True)
            fall = float(gradient @ inverse @ gradient)
        return fall <= MOST_FALL * self.noise_factor**2

    def at_bound(self, i: int) -> bool:
        """Return True if a constant is at a bound of the search that is not its limit."""
        return at_bound(float(self.values[i]), self._searched(i), self.limits[i])

    @property
    def is_limited(self) -> bool:
        """Return True if a constant is at its physical limit."""
        return bool(np.isfinite(self.lowest).any())

    def _searched(self, i: int) -> tuple[float, float]:
        low, high = self.bounds[i]
        return float(low), float(high)

    def _lowest(self) -> FloatArray:
        """Return the step of each coordinate to its physical limit; -inf if it is not there."""
        lowest = np.full(len(self.names), -np.inf)
        for i, limit in enumerate(self.limits):
            if limit is not None and at_limit(float(self.values[i]), self._searched(i), limit):
                lowest[i] = (limit - self.values[i]) / self.scale[i]
        return lowest

    def _best_step(self) -> tuple[FloatArray, float]:
        """Return the Gauss step, and its reduction of the sum of squares."""
        if self.is_limited:
            return limited_step(self.information, self.gradient, self.lowest)
        step = -self._inverse() @ self.gradient
        return step, float(self.gradient @ self._inverse() @ self.gradient)

    def _reach(self, slope: FloatArray, variance: float) -> tuple[float, float]:
        """Return the distances from a value to the ends of its interval."""
        if self.is_limited:
            root = self.error_root
            return limited_reach(slope, variance, root @ root.T, self.lowest)
        reach = DEVIATIONS * float(np.sqrt(variance))
        return reach, reach

    def _sources(self, others: OtherProblems) -> tuple[ErrorSource, ...]:
        """Return the sources of error: image, misfit, mesh and groups of nuisances."""
        factor = self.noise_factor
        root = self.eigenvectors[:, self.seen] / np.sqrt(self.eigenvalues[self.seen])
        here = LocalProblem(self.names, self.scale, root, self.gradient, factor)
        sources = [
            ErrorSource(IMAGE_AND_PRIOR if self.priors else IMAGE, root),
            ErrorSource(MISFIT, np.sqrt(factor**2 - 1) * root),
        ]
        if others.nuisances is not None:
            sources += nuisance_sources(here, others.nuisances, others.priors)
        mesh = mesh_source(here, others.meshes)
        return tuple(sources) if mesh is None else (*sources, mesh)

    def moved(self, i: int, by: FloatArray) -> FloatArray:
        """Return values of a constant at distances from the candidate, in internal units."""
        if self.logarithmic[i]:
            return np.asarray(self.values[i] * np.exp(np.clip(by, -50.0, 50.0)))
        return np.asarray(self.values[i] + self.scale[i] * by)

    def ratio_ends(self, i: int, j: int) -> tuple[float, float]:
        """Return the interval of constant i over constant j, both logarithmic.

        A common factor changes nothing, so j is held and the other constants are free.
        """
        others = [k for k in range(len(self.names)) if k != j]
        part = self.information[np.ix_(others, others)]
        own = self.noise_factor**2 * np.linalg.pinv(part)[others.index(i), others.index(i)]
        beside = (s for s in self.sources if s.name not in (IMAGE, IMAGE_AND_PRIOR, MISFIT))
        sd = np.sqrt(own + sum(s.sd[i] ** 2 + s.sd[j] ** 2 for s in beside))
        step = float(self.step[i] - self.step[j])
        reach = DEVIATIONS * float(sd)
        ratio = float(self.values[i] / self.values[j])
        low, high = min(0.0, step) - reach, max(0.0, step) + reach
        return ratio * float(np.exp(max(low, -50.0))), ratio * float(np.exp(min(high, 50.0)))

    def directions(self) -> list[Direction]:
        """Return the eigenvectors of the information, from the best to the least determined."""
        directions = []
        for k in range(len(self.names))[::-1]:
            vector = self.eigenvectors[:, k]
            vector = vector / vector[int(np.argmax(np.abs(vector)))]
            weights = dict(zip(self.names, map(float, vector), strict=True))
            sd = None
            if self.seen[k]:
                size = float(np.linalg.norm(vector))
                sd = self.noise_factor / (size * float(np.sqrt(self.eigenvalues[k])))
            directions.append(Direction(weights, sd, _in_words(weights, sd)))
        return directions

    def _inverse(self) -> FloatArray:
        """Return the inverse of the information, without unidentified directions."""
        vectors = self.eigenvectors[:, self.seen]
        return np.asarray((vectors / self.eigenvalues[self.seen]) @ vectors.T)

    def _unseen_root(self, bounds: FloatArray) -> FloatArray:
        """Return a square root of the covariance along unidentified directions, shape (p, k).

        Along each of the k directions the whole searched interval is possible.
        """
        logs = np.log(np.maximum(bounds, 1e-300))
        width = np.where(self.logarithmic, np.ptp(logs, axis=1), 1.0)
        unseen = self.eigenvectors[:, ~self.seen]
        return np.asarray(unseen * np.sqrt((unseen**2).T @ (width**2 / 12)))

    def _limited(self, step: FloatArray, bounds: FloatArray) -> FloatArray:
        """Keep a step within the searched intervals."""
        safe = np.where(self.logarithmic[:, None], np.maximum(bounds, 1e-300), 1.0)
        here = np.where(self.logarithmic, np.log(np.maximum(self.values, 1e-300)), 0.0)
        logs = np.log(safe) - here[:, None]
        lines = (bounds - self.values[:, None]) / self.scale[:, None]
        ends = np.where(self.logarithmic[:, None], logs, lines)
        return np.clip(step, np.minimum(ends[:, 0], 0.0), np.maximum(ends[:, 1], 0.0))


def _in_words(weights: Mapping[str, float], sd: float | None) -> str:
    """Return the description of a direction, without a full stop."""
    named = sorted(
        ((n, w) for n, w in weights.items() if abs(w) >= LEAST_SHARE),
        key=lambda pair: -abs(pair[1]),
    )
    known = "not determined at all" if sd is None else f"known to {share(sd)}"
    if len(named) == 1:
        return f"{named[0][0]} alone, {known}"
    changes = [f"{n} {'up' if w > 0 else 'down'} by {10 * abs(w):.2g} %" for n, w in named]
    return f"{' with '.join(changes)}, {known}"


class Posterior:
    """The joint distribution of the searched constants.

    Parameters
    ----------
    local : LocalModel
        The least-squares problem at the best candidate.
    searched : SearchedConstants
    """

    def __init__(self, local: LocalModel, searched: SearchedConstants) -> None:
        self.local, self.searched = local, searched
        ends = np.array([local.coordinate_ends(i) for i in range(len(local.names))])
        root = local.error_root
        sd = np.linalg.norm(root, axis=1)
        half = np.ptp(ends, axis=1) / 2
        self.middle = ends.mean(axis=1)
        self.root = root * (half / (DEVIATIONS * np.where(sd > 0, sd, 1.0)))[:, None]
        hold_read_only(self)

    def draw(self, names: Sequence[str], count: int, seed: int) -> list[FloatArray]:
        """Draw from the joint posterior of all constants.

        Parameters
        ----------
        names : sequence of str
            Internal names of the constants to return; all constants are drawn, so the draws
            of a constant do not depend on this choice.
        count : int
            Number of draws, > 0.
        seed : int

        Returns
        -------
        list of ndarray, shape (count,)
            For each name, in its external unit.
        """
        normal = np.random.default_rng(seed).standard_normal((count, self.root.shape[1]))
        coordinates = self.middle + normal @ self.root.T
        return [self._at_door(name, coordinates) for name in names]

    def _at_door(self, name: str, coordinates: FloatArray) -> FloatArray:
        i, parameter = self.local.names.index(name), self.searched.parameter(name)
        inside = np.clip(self.local.moved(i, coordinates[:, i]), *parameter.admissible)
        return np.asarray(inside * parameter.unit.to_door(1.0))
