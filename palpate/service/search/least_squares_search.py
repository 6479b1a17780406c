"""Fits of constants by derivatives: several descents in parallel, from coarse to fine.

::

    level 0     `starts` descents, each with one trial per generation
    level 1     the best of them continues from its end point, on a finer mesh
    ...
    the study's own resolution, until it has converged

A generation contains one trial point of each running descent. The search is a fold over the
generations, see `service.search.search_interface`. A polished search refines the best candidates
of a genetic search in this way.

Parameters are in the coordinates of `service.search.log_coordinates.LogSpace`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.service.search.genetic_operators import with_start
from palpate.service.search.search_interface import (
    FloatArray,
    Generation,
    LogSpace,
    Proposal,
    Search,
    Space,
    Stopped,
)
from palpate.storage.errors import InputError
from palpate.storage.values import FitJson
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.organs.trust_region_descent import (
    Descent,
    Tolerance,
    advance_descent,
    begin_descent,
)

# Starts other than the middle are drawn from this part of the box, where simulations converge.
START_RANGE = (0.15, 0.85)
# A coarse mesh and coarse voxels shift the optimum by several standard deviations, so there
# is no point in fitting the last per cent of the sum of squares.
COARSE_TOLERANCE, FINE_TOLERANCE = Tolerance(1.0, part=0.01), Tolerance(0.1)
# A start whose simulation fails is redrawn anywhere in the box, up to this many times.
NEW_STARTS = 10
# A descent that comes this close to another one, in logarithms, is merged with it.
SAME_PLACE = 0.02
# The coarser level ends close to the optimum of the finer one.
FINER_RADIUS = 0.35


@dataclass(frozen=True)
class LeastSquaresSettings:
    """Settings of a fit by derivatives.

    Parameters
    ----------
    starts : int
        Descents on the first level, >= 1: from the middle of the box in logarithms, and from
        points around it.
    levels : int
        Number of resolutions coarser than the study's own.
    evaluations : int
        Maximum number of evaluations of one descent on one level.
    start : tuple of tuple of float
        Genes at which the first descents start.
    """

    starts: int = 3
    levels: int = 0
    evaluations: int = 20
    start: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if self.starts < 1 or self.levels < 0 or self.evaluations < 2:
            raise InputError(
                "A fit needs at least one start and two evaluations of each, found "
                f"search.starts {self.starts}, search.fit_evaluations {self.evaluations}."
            )

    @property
    def most_evaluations(self) -> int:
        """Return the number of evaluations if no descent converges."""
        return self.evaluations * (self.starts + self.levels)


@dataclass(frozen=True)
class FittedNames:
    """Names and units of the genes in the least-squares problem of an evaluation.

    Parameters
    ----------
    inside : sequence of str
        Internal name of each gene.
    per_inside : sequence of float
        External units per internal unit.
    """

    inside: tuple[str, ...]
    per_inside: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _Progress:
    """All descents of the current level."""

    level: int
    descents: tuple[Descent, ...]

    @property
    def running(self) -> list[int]:
        return [i for i, d in enumerate(self.descents) if d.state == "running"]

    @property
    def best(self) -> Descent | None:
        ended = [d for d in self.descents if d.here is not None]
        return min(ended, key=lambda d: d.cost, default=None)


class LeastSquaresSearch:
    """A `Search` by derivatives.

    Parameters
    ----------
    space : Space
    names : FittedNames
    settings : LeastSquaresSettings
    seed : int
        Seed of the random starts.
    """

    def __init__(
        self, space: Space, names: FittedNames, settings: LeastSquaresSettings, seed: int
    ) -> None:
        self.space, self.names, self.settings, self.seed = space, names, settings, seed
        self.logs = LogSpace(space)

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the trial points that follow `history`, or the reason to stop."""
        return self.propose_from(self.starts(), history)

    def propose_from(self, starts: FloatArray, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the trial points or the reason to stop; descents begin at `starts`, (n, d)."""
        coordinates = self.logs.coordinates(starts)
        progress = _Progress(0, tuple(begin_descent(point) for point in coordinates))
        for generation in history:
            progress = self._after(progress, generation)
        running = progress.running
        if not running:
            return Stopped(self._reason(progress))
        trials = np.stack([progress.descents[i].trial for i in running])
        own = progress.level == self.settings.levels
        return Proposal(
            self.logs.genes(trials),
            (None,) * len(running),
            level=None if own else progress.level,
            derivatives=True,
        )

    def starts(self) -> FloatArray:
        """Return the starting points of the descents, shape (starts, d)."""
        n, d = self.settings.starts, self.space.dimension
        rng = np.random.default_rng([self.seed, 0x1E57])
        low, high = START_RANGE
        strata = np.stack([rng.permutation(n - 1) for _ in range(d)], axis=1) + 0.5
        around = low + (high - low) * strata / max(1, n - 1)
        unit = np.concatenate([np.full((1, d), 0.5), around])
        return with_start(self.logs.genes(self.logs.point(unit)), self.settings.start)

    def _begun_elsewhere(self, i: int, failed: Descent) -> Descent:
        """Return descent `i` from a new start, uniform in the box rather than in logarithms."""
        rng = np.random.default_rng([self.seed, 0x1E58, i, failed.evaluations])
        at = self.logs.coordinates(rng.uniform(self.space.lower, self.space.upper))
        return replace(begin_descent(at), evaluations=failed.evaluations)

    def _after(self, progress: _Progress, generation: Generation) -> _Progress:
        """Return the progress after a generation."""
        running = progress.running
        if len(generation.fits) != len(running):
            raise InputError(
                f"A generation of this fit has {len(running)} candidates, but the journal has "
                f"{len(generation.fits)} with derivatives. The study was changed after it was "
                "started: restore its search, or start a new study."
            )
        own = progress.level == self.settings.levels
        tolerance = FINE_TOLERANCE if own else COARSE_TOLERANCE
        descents = list(progress.descents)
        for i, fit, genes in zip(running, generation.fits, generation.genes, strict=True):
            there = None if fit is None else self._squares(fit, genes)
            most = self.settings.evaluations
            descents[i] = advance_descent(descents[i], there, self.logs.box, tolerance, most)
            if descents[i].state == "failed" and descents[i].evaluations <= NEW_STARTS:
                descents[i] = self._begun_elsewhere(i, descents[i])
        descents = _merged(descents)
        progress = replace(progress, descents=tuple(descents))
        best = progress.best
        if progress.running or own or best is None:
            return progress
        return _Progress(progress.level + 1, (begin_descent(best.at, FINER_RADIUS),))

    def _squares(self, fit: FitJson, genes: FloatArray) -> NormalEquations:
        per_inside = np.asarray(self.names.per_inside)
        order = places_in_fit(fit, self.names.inside, genes / per_inside)
        return squares_of(fit, self.logs, order, per_inside)

    def _reason(self, progress: _Progress) -> str:
        best = progress.best
        if best is None:
            return "no start of the fit could be simulated"
        if best.evaluations >= self.settings.evaluations:
            return f"the fit has not converged in {best.evaluations} evaluations"
        return "no step of the fit promises a smaller sum of squared distances"


def squares_of(
    fit: FitJson, logs: LogSpace, order: list[int], per_inside: FloatArray
) -> NormalEquations:
    """Return the normal equations of an evaluation, in the coordinates of `logs`.

    Parameters
    ----------
    order : list of int
        Position of each gene in the fit.
    per_inside : ndarray, shape (d,)
        External units per internal unit.
    """
    scale = np.where(logs.logarithmic, 1.0, logs.width / per_inside)
    g = np.asarray(fit["gradient"], np.float64)[order] * scale
    h = np.asarray(fit["hessian"], np.float64)[np.ix_(order, order)] * np.outer(scale, scale)
    return NormalEquations(float(fit["cost"]), g, h, int(fit["residuals"]))


def places_in_fit(fit: FitJson, names: Sequence[str], values: FloatArray) -> list[int]:
    """Return the position of each gene in a fit, given the internal `values` of the genes.

    Positions are found by name. An organ may sort interchangeable constants, however; those
    are found by value.
    """
    free, order = list(range(len(names))), []
    for name, value in zip(names, values, strict=True):
        own = fit["parameters"].index(name)
        place = min(free, key=lambda k: (not np.isclose(fit["values"][k], value, 1e-9), k != own))
        free.remove(place)
        order.append(place)
    return order


def _merged(descents: Sequence[Descent]) -> list[Descent]:
    """Mark descents that have come close to a better one as merged."""
    kept: list[Descent] = []
    for descent in descents:
        near = any(
            other.state in ("running", "converged")
            and other.here is not None
            and float(np.abs(other.trial - descent.trial).max()) < SAME_PLACE
            for other in kept
        )
        merged = near and descent.state == "running" and descent.here is not None
        kept.append(replace(descent, state="merged") if merged else descent)
    return kept


# Candidates closer than this fraction of every searched interval count as one start.
SAME_START = 0.05


class PolishedSearch:
    """A `Search`: a genetic search, then descents from its best few candidates.

    The genetic part is bit-identical to a genetic search on its own.

    Parameters
    ----------
    genetic : Search
        Proposes the generations.
    polish : LeastSquaresSearch
        Fits the best candidates, as many as it has `starts`.
    """

    def __init__(self, genetic: Search, polish: LeastSquaresSearch) -> None:
        self.genetic, self.polish = genetic, polish

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population or trial points that follow `history`, or the reason to stop."""
        searched = [g for g in history if not g.fits]
        fitted = [g for g in history if g.fits]
        proposed = self.genetic.propose(searched)
        if isinstance(proposed, Proposal):
            return proposed
        starts = self.best_few(searched)
        if not len(starts):
            return proposed
        polished = self.polish.propose_from(starts, fitted)
        if isinstance(polished, Proposal):
            return polished
        return Stopped(f"{proposed.reason}; {polished.reason}")

    def best_few(self, searched: Sequence[Generation]) -> FloatArray:
        """Return the best distinct candidates, best first, shape (n, d)."""
        genes = np.concatenate([g.genes for g in searched])
        scores = np.concatenate([g.scores for g in searched])
        space, few = self.polish.space, self.polish.settings.starts
        chosen: list[FloatArray] = []
        for i in np.argsort(scores, kind="stable"):
            if len(chosen) == few or np.isposinf(scores[i]):
                break
            apart = [np.abs(genes[i] - other) / space.span for other in chosen]
            if all(float(a.max()) > SAME_START for a in apart):
                chosen.append(genes[i])
        return np.array(chosen).reshape(-1, space.dimension)
