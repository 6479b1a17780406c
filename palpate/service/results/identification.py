r"""Identifiability of each constant of a model, or only of ratios, from an image.

With the residuals r of the best candidate, in units of their noise, and their derivatives J,
the Gauss step leads to the constants that explain the image best, and the inverse of the
information bounds their covariance from below (H. Cramér 1946, C. R. Rao 1945):

.. math:: \delta = -(J'J)^{-1} J' r, \qquad C = s^2 (J'J)^{-1}, \qquad
          s^2 = \max\left(1, \frac{|r + J\delta|^2}{m - p}\right).

The factor s widens the intervals if the residual exceeds the noise. The mesh and possible model
errors widen them, too; see `service.results.error_budget`. An interval spans the intervals
around the best candidate and around :math:`\delta` from there, so that it also covers the
unfinished part of the search.

Plates at a given distance determine only ratios of stiffnesses without a force.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from palpate.service.results.intervals import (
    Direction,
    LocalModel,
    OtherProblems,
    RelativeInterval,
    SearchedConstants,
)
from palpate.service.results.physical_limits import at_limit
from palpate.service.results.quotability_rule import IdentifiedAs
from palpate.service.search.search_interface import FloatArray
from palpate.storage.read_only import ReadOnly
from palpate.storage.values import FitJson

STIFFNESS_UNITS = ("kPa", "Pa")


class Estimate(Protocol):
    """The part of a `service.results.result_records.ParameterEstimate` used here."""

    @property
    def unit(self) -> str:
        """Return the unit of the numbers."""

    @property
    def estimate(self) -> float | None:
        """Return the best value."""

    @property
    def target(self) -> float | None:
        """Return the true value of a simulated target."""


@dataclass(frozen=True)
class RatioEstimate:
    """The ratio of two stiffnesses.

    Parameters
    ----------
    numerator, denominator : str
        Internal names, such as ``E_glandular`` and ``E_fat``.
    estimate, target : float or None
        As in a `ParameterEstimate`.
    """

    numerator: str
    denominator: str
    estimate: float | None
    target: float | None

    @property
    def name(self) -> str:
        """Return ``E_glandular / E_fat``."""
        return f"{self.numerator} / {self.denominator}"

    @property
    def relative_error(self) -> float | None:
        """Return ``|estimate - target| / target``; None if either is unknown."""
        if self.estimate is None or not self.target:
            return None
        return abs(self.estimate - self.target) / self.target


def ratio_estimates(estimates: Mapping[str, Estimate]) -> tuple[RatioEstimate, ...]:
    """Return the ratios of the other stiffnesses to the first one that was searched."""
    stiff = [(name, e) for name, e in estimates.items() if e.unit in STIFFNESS_UNITS]
    if not stiff:
        return ()
    (base, below), *others = stiff
    return tuple(
        RatioEstimate(
            name, base, _divided(e.estimate, below.estimate), _divided(e.target, below.target)
        )
        for name, e in others
    )


def _divided(above: float | None, below: float | None) -> float | None:
    return None if above is None or not below else above / below


LEVEL = 0.9
# A constant is weakly determined if its interval is wider than this fraction of its value.
WEAK_PART = 0.5
# Fewest equally good candidates for an interval from their scatter.
FEWEST_CANDIDATES = 5
# Above this correlation, the value of one constant depends on that of another.
DEPENDENT = 0.3
TANGENTS, SCATTER = "tangents", "scatter of equally good candidates"


@dataclass(frozen=True)
class Interval:
    """The interval of a constant.

    Parameters
    ----------
    lower, upper : float
        In external units.
    level : float
        Probability that the interval covers the true value.
    origin : str
        ``tangents``, or ``scatter of equally good candidates``.
    """

    lower: float
    upper: float
    level: float
    origin: str


@dataclass(frozen=True)
class IdentifiedConstant(ReadOnly):
    """The identifiability of one searched constant.

    Parameters
    ----------
    name : str
        Internal name, such as ``E_fat``.
    estimate : float
        Value of the best candidate, in `unit`.
    unit : str
        Such as kPa; empty for a pure number.
    interval : Interval or None
        None if only ratios can be found, or nothing is known.
    identifiable : {"value", "limit", "ratio", "weak", "unknown"}
        ``limit``: it rests at its physical limit, from which the interval begins. ``ratio``: only
        its ratio to the others, see `IdentifiedRatio`. ``weak``: the interval is wider than half
        the value. ``unknown``: it is wider than the searched interval.
    errors : mapping of str to float
        Standard deviation contributed by each source of error, in `unit`.
    depends_on : tuple of str
        Constants at a bound of the search, not at a physical limit, that affect the value.
    prior_share : float
        Part of the information on the value that its prior contributes, 0 to 1.
    """

    name: str
    estimate: float
    unit: str
    interval: Interval | None
    identifiable: IdentifiedAs
    errors: Mapping[str, float] = field(default_factory=dict)
    depends_on: tuple[str, ...] = ()
    prior_share: float = 0.0


@dataclass(frozen=True)
class IdentifiedRatio:
    """The identifiability of the ratio of two constants.

    Parameters
    ----------
    numerator, denominator : str
        Internal names.
    estimate : float
    interval : Interval or None
    identifiable : {"value", "weak", "unknown"}
        Identifiability of the ratio.
    """

    numerator: str
    denominator: str
    estimate: float
    interval: Interval | None
    identifiable: IdentifiedAs


@dataclass(frozen=True)
class Identification(ReadOnly):
    """The identifiability of a model's constants from an image.

    Parameters
    ----------
    candidate : int
        The best candidate, at which the derivatives were taken.
    constants : mapping of str to IdentifiedConstant
        By internal name.
    ratios : tuple of IdentifiedRatio
        Ratios, if only these can be found; otherwise empty.
    names : tuple of str
        Names of the rows and columns of the correlation.
    correlation : tuple of tuple of float
        Correlation of the constants' errors; empty without derivatives.
    directions : tuple of Direction
        From the best to the least determined; empty without derivatives.
    residual_rms_mm : float or None
        RMS distance between the interfaces of model and image.
    noise : str
        The noise by which the residuals were divided, as text.
    noise_factor : float
        Ratio of the residuals to that noise, at least 1.
    note : str
        Why information is missing; empty otherwise.
    converged : bool
        Whether the best candidate minimises the sum of squares; if not, intervals are withheld.
    supported : tuple of str
        Errors of the scan or the model with decisive support from the residual, as noun phrases.
    derived : mapping of str to RelativeInterval
        Intervals of values derived from the constants, such as G0 of a cornea.
    """

    candidate: int
    constants: Mapping[str, IdentifiedConstant]
    ratios: tuple[IdentifiedRatio, ...] = ()
    names: tuple[str, ...] = ()
    correlation: tuple[tuple[float, ...], ...] = ()
    directions: tuple[Direction, ...] = ()
    residual_rms_mm: float | None = None
    noise: str = ""
    noise_factor: float = 1.0
    note: str = ""
    converged: bool = True
    supported: tuple[str, ...] = ()
    derived: Mapping[str, RelativeInterval] = field(default_factory=dict)

    def __repr__(self) -> str:
        answers = ", ".join(f"{name} {c.identifiable}" for name, c in self.constants.items())
        return f"<Identification at candidate {self.candidate}: {answers}"[:498] + ">"

    @property
    def weak(self) -> tuple[str, ...]:
        """Return the names of the constants that are weakly determined or undetermined."""
        return tuple(
            name for name, c in self.constants.items() if c.identifiable in ("weak", "unknown")
        )


def identification_from_tangents(
    searched: SearchedConstants,
    candidate: int,
    fit: FitJson,
    others: OtherProblems | None = None,
    derived: Sequence[Mapping[str, Any]] = (),
) -> Identification:
    """Return the identification from the least-squares problem of the best candidate.

    Parameters
    ----------
    searched : SearchedConstants
    candidate : int
        The best candidate.
    fit : FitJson
    others : OtherProblems, optional
        The same candidate with nuisance parameters and on other meshes.
    derived : sequence of mapping
        Values derived from the constants: ``name``, ``slope``, ``mesh_shift`` and ``mesh_sd``,
        see `LocalModel.relative_interval`.
    """
    local = LocalModel(fit, searched, others)
    constants = {name: _constant(searched, local, i) for i, name in enumerate(local.names)}
    return Identification(
        candidate=candidate,
        constants=constants,
        ratios=tuple(_ratios(local)),
        names=local.names,
        correlation=local.correlation,
        directions=tuple(local.directions()),
        residual_rms_mm=float(fit["rms_mm"]),
        noise=fit["noise"],
        noise_factor=local.noise_factor,
        converged=local.converged,
        supported=local.supported,
        derived={quantity["name"]: _interval_of(local, quantity) for quantity in derived},
    )


def _interval_of(local: LocalModel, one: Mapping[str, Any]) -> RelativeInterval:
    return local.relative_interval(one["slope"], one["mesh_shift"], one["mesh_sd"])


def identification_from_scatter(
    searched: SearchedConstants,
    candidate: int,
    best: Mapping[str, float],
    equally_good: Sequence[Mapping[str, float]],
    note: str,
) -> Identification:
    """Return the identification from the scatter of equally good candidates, in internal units.

    With fewer than `FEWEST_CANDIDATES` candidates there are no intervals.
    """
    constants = {}
    for name in searched.bounds:
        values = np.array([genes[name] for genes in equally_good])
        ends = None
        if len(values) >= FEWEST_CANDIDATES:
            ends = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            ends = np.array([min(ends[0], best[name]), max(ends[1], best[name])])
        constants[name] = _judged(searched, name, best[name], ends, SCATTER)
    return Identification(candidate, constants, note=note)


def _constant(searched: SearchedConstants, local: LocalModel, i: int) -> IdentifiedConstant:
    name, value = local.names[i], float(local.values[i])
    if local.common[i]:
        parameter = searched.parameter(name)
        estimate = searched.at_door(name, value)
        return IdentifiedConstant(name, estimate, parameter.unit.symbol, None, "ratio")
    ends = None if local.unseen(i) else local.ends(i)
    errors = {source: searched.at_door(name, sd) for source, sd in local.errors(i).items()}
    judged = _judged(searched, name, value, ends, TANGENTS)
    share = local.prior_share(i)
    return replace(judged, errors=errors, depends_on=_depends_on(local, i), prior_share=share)


def _depends_on(local: LocalModel, i: int) -> tuple[str, ...]:
    """Return the constants at a bound whose errors correlate with those of constant i."""
    return tuple(
        name
        for j, name in enumerate(local.names)
        if j != i and local.at_bound(j) and abs(local.correlation[i][j]) > DEPENDENT
    )


def _judged(
    searched: SearchedConstants, name: str, value: float, ends: FloatArray | None, origin: str
) -> IdentifiedConstant:
    """Return a constant with its interval, given in internal units, and its identifiability."""
    parameter, estimate = searched.parameter(name), searched.at_door(name, value)
    if name in searched.common_scale:
        return IdentifiedConstant(name, estimate, parameter.unit.symbol, None, "ratio")
    if ends is None:
        return IdentifiedConstant(name, estimate, parameter.unit.symbol, None, "unknown")
    least, most = searched.bounds[name]
    limited = _reaches_limit(searched, name, value, ends, origin)
    if (limited or ends[0] < least) and ends[1] > most and origin == TANGENTS:
        return IdentifiedConstant(name, estimate, parameter.unit.symbol, None, "unknown")
    low, high = np.clip(ends, *parameter.admissible)
    low = least if limited else low
    lower, upper = searched.at_door(name, float(low)), searched.at_door(name, float(high))
    verdict: IdentifiedAs = "weak" if upper - lower > WEAK_PART * abs(estimate) else "value"
    verdict = "limit" if limited else verdict
    interval = Interval(lower, upper, LEVEL, origin)
    return IdentifiedConstant(name, estimate, parameter.unit.symbol, interval, verdict)


def _reaches_limit(
    searched: SearchedConstants, name: str, value: float, ends: FloatArray, origin: str
) -> bool:
    """Return True if a constant rests at its physical limit, and its interval begins there."""
    bounds, limit = searched.bounds[name], searched.parameter(name).limit
    if limit is None or not at_limit(value, bounds, limit):
        return False
    # Candidates scatter inside the searched interval, never up to its end.
    return origin == SCATTER or float(ends[0]) - limit <= 1e-9 * (bounds[1] - bounds[0])


def _ratios(local: LocalModel) -> list[IdentifiedRatio]:
    """Return the ratios of constants with an unknown common scale to the first of them."""
    common = [i for i in range(len(local.names)) if local.common[i] and local.logarithmic[i]]
    ratios = []
    for i in common[1:]:
        j = common[0]
        lower, upper = local.ratio_ends(i, j)
        estimate = float(local.values[i] / local.values[j])
        verdict: IdentifiedAs = "weak" if upper - lower > WEAK_PART * estimate else "value"
        interval = Interval(lower, upper, LEVEL, TANGENTS)
        ratios.append(IdentifiedRatio(local.names[i], local.names[j], estimate, interval, verdict))
    return ratios
