"""The ``search`` section of a study file: strategies by name, and their settings.

A distribution offers a `Strategy` as an entry point of the group ``palpate.searches``; a study
chooses it with ``search.strategy``. A strategy states the most evaluations it can take.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from palpate.service.search.cma_search import CMA_STALL_GENERATIONS, CmaSearch, CmaSettings
from palpate.service.search.constraints import ConstrainedSearch, Constraint, Constraints
from palpate.service.search.genetic_operators import (
    INITIAL,
    MUTATIONS,
    Initial,
    StartingAt,
    genes_of,
)
from palpate.service.search.genetic_search import GeneticSearch, GeneticSettings
from palpate.service.search.least_squares_search import (
    FittedNames,
    LeastSquaresSearch,
    LeastSquaresSettings,
    PolishedSearch,
)
from palpate.service.search.search_interface import LogScale, LogScaledSearch, Search, Space
from palpate.service.search.stop_rules import Stall
from palpate.storage.errors import InputError
from palpate.workers.common_keys import Door, Finite, Positive, checked_name
from palpate.workers.mechanics.model_parameters import Bounds
from palpate.workers.plugins import load


@dataclass(frozen=True, slots=True)
class SearchRequest:
    """The input of a strategy.

    Parameters
    ----------
    search : SearchSpec
        The keys under ``search``.
    names : FittedNames
        Names and units of the constants in an evaluation's least-squares problem.
    levels : int
        Number of coarser resolutions that are fitted first.
    seed : int
    """

    search: "SearchSpec"
    names: FittedNames
    levels: int
    seed: int

    @property
    def fit(self) -> LeastSquaresSettings:
        """Return the settings of a fit by derivatives."""
        search = self.search
        start = search.start_genes if search.strategy == LEAST_SQUARES.name else ()
        return LeastSquaresSettings(search.starts, self.levels, search.fit_evaluations, start)


@dataclass(frozen=True, slots=True)
class Strategy:
    """A search strategy.

    Parameters
    ----------
    name : str
        The value of ``search.strategy`` in a study file.
    make : callable
        Maps a `SearchRequest` to a `Search`, a pure function of the generations so far.
    most_evaluations, most_generations : callable
        Map a `SearchRequest` to the numbers for a search that never stops early.
    by_derivatives : bool
        Whether it needs the derivatives of each candidate.
    coarse_first : bool
        Whether it starts at coarser resolutions if the study names none.
    settings : tuple of str
        The keys under ``search`` that it uses in addition to ``parameters`` and ``strategy``;
        a warning lists others. Default: `stop`, which applies to every search.
    """

    name: str
    make: Callable[[SearchRequest], Search]
    most_evaluations: Callable[[SearchRequest], int]
    most_generations: Callable[[SearchRequest], int]
    by_derivatives: bool = False
    coarse_first: bool = False
    settings: tuple[str, ...] = ("stop",)


def strategy_named(name: str) -> Strategy:
    """Return the strategy with a given name.

    Raises
    ------
    InputError
        If the name is unknown; close names are suggested.
    """
    found: Strategy = load("searches", name)
    return found


def _genetic(asked: SearchRequest) -> Search:
    search, scale = asked.search, asked.search.log_scale
    if scale is None:
        return GeneticSearch(search.space, search.settings, asked.seed)
    inner = GeneticSearch(scale.inner, search.settings_on(scale), asked.seed)
    return LogScaledSearch(inner, scale)


def _cma(asked: SearchRequest) -> CmaSearch:
    return CmaSearch(asked.search.space, asked.search.cma_settings, asked.seed)


def _constrained(make: Callable[[SearchRequest], Search]) -> Callable[[SearchRequest], Search]:
    """Return a factory for the same searches, within the constraints of a study."""

    def made(asked: SearchRequest) -> Search:
        constraints, search = asked.search.inequalities, make(asked)
        return search if constraints is None else ConstrainedSearch(search, constraints)

    return made


def _least_squares(asked: SearchRequest) -> LeastSquaresSearch:
    return LeastSquaresSearch(asked.search.space, asked.names, asked.fit, asked.seed)


def _fit_generations(asked: SearchRequest) -> int:
    return asked.search.fit_evaluations * (1 + asked.levels)


_OF_ALL = ("start", "stop")
_OF_FITS = ("starts", "levels", "fit_evaluations")
_OF_GENERATIONS = ("population", "generations", "stall")
_OF_BREEDING = (*_OF_GENERATIONS, "elite", "crossover_fraction", "mutation", "initial")

GENETIC = Strategy(
    "genetic",
    make=_constrained(_genetic),
    most_evaluations=lambda asked: asked.search.settings.most_evaluations,
    most_generations=lambda asked: asked.search.generations,
    settings=(*_OF_ALL, *_OF_BREEDING, "mode", "in_flight", "scale", "constraints"),
)
CMA = Strategy(
    "cma",
    make=_constrained(_cma),
    most_evaluations=lambda asked: asked.search.cma_settings.most_evaluations,
    most_generations=lambda asked: asked.search.generations,
    settings=(*_OF_ALL, *_OF_GENERATIONS, "constraints"),
)
LEAST_SQUARES = Strategy(
    "least-squares",
    make=_least_squares,
    most_evaluations=lambda asked: asked.fit.most_evaluations,
    most_generations=_fit_generations,
    by_derivatives=True,
    coarse_first=True,
    settings=(*_OF_ALL, *_OF_FITS, "prior"),
)
POLISHED = Strategy(
    "genetic+least-squares",
    make=lambda asked: PolishedSearch(_genetic(asked), _least_squares(asked)),
    most_evaluations=lambda asked: (
        asked.search.settings.most_evaluations + asked.fit.most_evaluations
    ),
    most_generations=lambda asked: asked.search.generations + _fit_generations(asked),
    by_derivatives=True,
    settings=(*_OF_ALL, *_OF_BREEDING, *_OF_FITS, "scale", "prior"),
)


StrategyName = Annotated[str, AfterValidator(lambda name: checked_name("searches", name))]


class StallSpec(Door):
    """Criterion for stopping a search that no longer improves; see `search_interface`.

    Parameters
    ----------
    generations
        Number of generations considered.
    tolerance
        Smallest change in the best score that counts as an improvement.
    rule
        ``relative``: the mean relative change over the generations; ``weighted``: recent changes
        count more.
    """

    generations: Annotated[int, Field(ge=1)] = 5
    tolerance: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1e-6
    rule: Literal["relative", "weighted"] = "relative"


class LevelSpec(Door):
    """A coarser resolution in which constants are fitted first.

    Parameters
    ----------
    nodes
        Approximate number of nodes of the mesh.
    spacing_mm
        Size of the voxels, in mm.
    """

    nodes: Annotated[int, Field(ge=100, le=5_000_000)]
    spacing_mm: Positive


class StopSpec(Door):
    """Limits at which a search stops, whatever the strategy; checked at the end of a generation.

    Parameters
    ----------
    score
        Once the objective reaches this value, such as -8 for GSF.
    evaluations
        Before a generation that would exceed this number of evaluations.
    hours
        Once the study has run for this long, summed over all its runs.
    """

    score: Finite | None = None
    evaluations: Annotated[int, Field(ge=1)] | None = None
    hours: Positive | None = None


class PriorSpec(Door):
    """What is known of a parameter besides the images: a normal distribution.

    Parameters
    ----------
    mean
        In the parameter's unit, within its bounds.
    sd
        Standard deviation, in the same unit.
    """

    mean: Finite
    sd: Positive


class SearchSpec(Door):
    """Settings of the search; the defaults are the thesis'.

    ``stall: null`` never stops before the last generation. ``starts``, ``levels`` and
    ``fit_evaluations`` are for the least-squares strategies, see
    `least_squares_search`; the others for ``genetic`` and, where they apply, ``cma``.
    ``mode: steady`` has no barrier between generations: a candidate is bred as soon as one has
    ended, with up to `in_flight` at once (default: a population); see
    `service.search.genetic_search`.

    Parameters
    ----------
    strategy
        ``genetic`` (as in the thesis), ``cma``, ``least-squares``, ``genetic+least-squares``, or
        the name of a plug-in.
    starts
        Descents by derivatives from different points.
    levels
        Coarser resolutions in which constants are fitted first, coarse to fine. Default: 5,000 and
        20,000 nodes where the case has at least twice as many; none for ``genetic+least-squares``.
    fit_evaluations
        Largest number of evaluations of one descent on one level.
    population
        Candidates per generation.
    generations
        Largest number of generations, including the initial population.
    elite
        Best candidates of a generation that are carried over unchanged.
    crossover_fraction
        Share of the other candidates bred by crossover; the rest are mutations.
    mutation
        ``adaptive-feasible`` stays within the bounds; ``gaussian`` adds normal steps that shrink.
    initial
        How the first candidates are drawn.
    stall
        When to stop because the best score no longer improves; null: never.
    mode
        ``barrier``: one generation after the other; ``steady``: a new candidate as soon as one has
        ended.
    in_flight
        Candidates at once with ``mode: steady``. Default: `population`.
    start
        Points to start from, such as ``[{E_fat_kpa: 8, E_glandular_kpa: 30}]``: the first
        candidates, the first descents, or the middle for ``cma``.
    stop
        When to stop, whatever the strategy.
    scale
        ``log`` or ``linear`` for each parameter of a genetic search. Default: linear. The other
        strategies search the logarithm of every parameter whose lower bound is above zero.
    constraints
        Inequalities between parameters, such as ``E_glandular_kpa > 2 * E_fat_kpa``; for
        ``genetic`` and ``cma``.
    prior
        Mean and standard deviation of parameters known from elsewhere, such as
        ``{E_fat_kpa: {mean: 8, sd: 2}}``; for the strategies that use derivatives, which weigh
        them against the noise of the images.
    """

    later_keys: ClassVar[tuple[str, ...]] = (
        "mode",
        "in_flight",
        "start",
        "stop",
        "scale",
        "constraints",
        "prior",
    )

    parameters: Annotated[dict[str, Bounds], Field(min_length=1)] = Field(
        description="lower and upper bound of each searched constant, such as [5, 20]"
    )
    strategy: Annotated[str, AfterValidator(lambda name: checked_name("searches", name))] = (
        "genetic"
    )
    starts: Annotated[int, Field(ge=1, le=100)] = 3
    levels: tuple[LevelSpec, ...] | None = None
    fit_evaluations: Annotated[int, Field(ge=2)] = 20
    population: Annotated[int, Field(ge=2)] = 84
    generations: Annotated[int, Field(ge=1)] = 15
    elite: Annotated[int, Field(ge=0)] = 2
    crossover_fraction: Annotated[float, Field(ge=0, le=1)] = 0.8
    mutation: Literal["adaptive-feasible", "gaussian"] = "adaptive-feasible"
    initial: Literal["uniform", "latin-hypercube"] = "uniform"
    stall: StallSpec | None = StallSpec()
    mode: Literal["barrier", "steady"] = "barrier"
    in_flight: Annotated[int, Field(ge=1)] | None = None
    start: tuple[dict[str, Finite], ...] = ()
    stop: StopSpec | None = None
    scale: dict[str, Literal["linear", "log"]] = Field(default_factory=dict)
    constraints: tuple[str, ...] = ()
    prior: dict[str, PriorSpec] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _steady_is_genetic(self) -> Self:
        if self.steady and self.strategy != "genetic":
            raise ValueError(f"mode: steady needs strategy: genetic, got {self.strategy}")
        if self.steady and (self.log_scaled or self.constraints or self._stops_by_candidates):
            raise ValueError(
                "scale, constraints, stop.score and stop.evaluations need mode: barrier"
            )
        if self.in_flight is not None and not self.steady:
            raise ValueError("in_flight needs mode: steady")
        return self

    def __repr__(self) -> str:
        between = [f"{n} {low:g} to {high:g}" for n, (low, high) in self.parameters.items()]
        return f"<Search by {self.strategy}: {', '.join(between)}"[:498] + ">"

    @property
    def steady(self) -> bool:
        """Return True if there is no barrier between generations."""
        return self.mode == "steady"

    @model_validator(mode="after")
    def _somebody_is_new(self) -> Self:
        if self.elite >= self.population:
            raise ValueError(
                f"elite ({self.elite}) must be less than population ({self.population}): "
                "at least one candidate must be new in every generation"
            )
        return self

    @model_validator(mode="before")
    @classmethod
    def _few_candidates_for_cma(cls, data: Any) -> Any:
        """Set CMA-ES' usual population, generations and stall instead of the thesis' defaults."""
        if isinstance(data, Mapping) and data.get("strategy") == "cma":
            patience = {"generations": CMA_STALL_GENERATIONS}
            return {"population": 12, "generations": 60, "stall": patience, **data}
        return data

    @model_validator(mode="after")
    def _points_and_inequalities_make_sense(self) -> Self:
        strategy = strategy_named(self.strategy)
        for key in ("constraints", "scale"):
            if getattr(self, key) and strategy.settings and key not in strategy.settings:
                raise ValueError(f"{key}: not supported by strategy {self.strategy}")
        if self.prior and not strategy.by_derivatives:
            raise ValueError(
                f"prior: strategy {self.strategy} minimises a score, which has no noise to weigh a "
                "prior against; use least-squares or genetic+least-squares"
            )
        most = {"cma": 1, "least-squares": self.starts}.get(self.strategy, self.population)
        if len(self.start) > most:
            raise ValueError(
                f"start: {len(self.start)} points, but strategy {self.strategy} takes {most}"
            )
        try:
            _ = self.start_genes, self.log_scale, self.inequalities, self.priors
        except InputError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def start_genes(self) -> tuple[tuple[float, ...], ...]:
        """Return the points of `start`, in the order of the parameters."""
        return genes_of(self.start, self.space) if self.start else ()

    @property
    def log_scaled(self) -> frozenset[str]:
        """Return the parameters searched on a logarithmic scale by a genetic search."""
        return frozenset(name for name, scale in self.scale.items() if scale == "log")

    @property
    def log_scale(self) -> LogScale | None:
        """Return the scales of a genetic search; None if all are linear."""
        unknown = [name for name in self.scale if name not in self.parameters]
        if unknown:
            raise InputError(f"scale: {unknown[0]} is not searched")
        return LogScale(self.space, self.log_scaled) if self.log_scaled else None

    @property
    def inequalities(self) -> Constraints | None:
        """Return the constraints; None if there are none."""
        parsed = [Constraint.parse(text) for text in self.constraints]
        return Constraints(self.space, parsed) if parsed else None

    @property
    def priors(self) -> dict[str, Bounds]:
        """Return mean and standard deviation of each parameter with a prior, external units."""
        for name, prior in self.prior.items():
            if name not in self.parameters:
                raise InputError(f"prior: {name} is not searched")
            low, high = self.parameters[name]
            if not low <= prior.mean <= high:
                raise InputError(
                    f"prior: the mean of {name}, {prior.mean:g}, is outside its bounds "
                    f"[{low:g}, {high:g}]"
                )
        return {name: (prior.mean, prior.sd) for name, prior in self.prior.items()}

    @property
    def _stops_by_candidates(self) -> bool:
        stop = self.stop or StopSpec()
        return stop.score is not None or stop.evaluations is not None

    @property
    def by_derivatives(self) -> bool:
        """Return True if the strategy needs derivatives."""
        return strategy_named(self.strategy).by_derivatives

    @property
    def cma_settings(self) -> CmaSettings:
        """Return the settings of `CmaSearch`."""
        start = self.start_genes[0] if self.start else None
        return CmaSettings(self.population, self.generations, self.settings.stall, start)

    @property
    def settings(self) -> GeneticSettings:
        """Return the settings of `GeneticSearch`."""
        stall = self.stall
        return GeneticSettings(
            population=self.population,
            generations=self.generations,
            elite=self.elite,
            crossover_fraction=self.crossover_fraction,
            stall=None if stall is None else Stall(**stall.model_dump()),
            mutation=MUTATIONS[self.mutation],
            initial=self._initial(),
        )

    def settings_on(self, scale: LogScale) -> GeneticSettings:
        """Return the settings of a `GeneticSearch` that uses other scales."""
        return replace(self.settings, initial=self._initial(scale))

    def _initial(self, scale: LogScale | None = None) -> Initial:
        drawn, points = INITIAL[self.initial], self.start_genes
        if points and scale is not None:
            points = tuple(map(tuple, scale.to_inner(np.array(points)).tolist()))
        return StartingAt(points, drawn) if points else drawn

    @property
    def space(self) -> Space:
        """Return the searched box, in external units."""
        return Space.from_bounds(self.parameters)


# Elements of about 5 and 3 mm in a breast of 445 ml; voxels a fifth of that.
COARSE_LEVELS = (LevelSpec(nodes=5_000, spacing_mm=1.0), LevelSpec(nodes=20_000, spacing_mm=0.5))
