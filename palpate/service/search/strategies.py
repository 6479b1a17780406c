"""Search strategies by name, with the most evaluations each can take.

A distribution offers a `Strategy` as an entry point of the group ``palpate.searches``; a study
chooses it with ``search.strategy``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from palpate.service.search.base import Search
from palpate.service.search.cma_search import CmaSearch
from palpate.service.search.constraints import ConstrainedSearch
from palpate.service.search.genetic import GeneticSearch
from palpate.service.search.least_squares import (
    FittedNames,
    LeastSquaresSearch,
    LeastSquaresSettings,
)
from palpate.service.search.log_scale import LogScaledSearch
from palpate.service.search.polished import PolishedSearch
from palpate.workers.plugins import load

if TYPE_CHECKING:
    from palpate.service.search.spec import SearchSpec


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
