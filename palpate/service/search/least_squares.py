"""Fits of constants by derivatives: several descents in parallel, from coarse to fine.

::

    level 0     `starts` descents, each with one trial per generation
    level 1     the best of them continues from its end point, on a finer mesh
    ...
    the study's own resolution, until it has converged

A generation contains one trial point of each running descent. The search is a fold over the
generations, see `service.search.base`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.service.search.base import Generation, Proposal, Stopped
from palpate.service.search.descent import Descent, SquaredSum, Tolerance, advance, begin
from palpate.service.search.log_space import LogSpace
from palpate.service.search.space import FloatArray, Space
from palpate.service.search.start_points import with_start
from palpate.storage.errors import InputError
from palpate.storage.records.tasks import FitJson

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
        at = self.logs.coordinates(starts)
        progress = _Progress(0, tuple(begin(point) for point in at))
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
        return replace(begin(at), evaluations=failed.evaluations)

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
            descents[i] = advance(descents[i], there, self.logs, tolerance, most)
            if descents[i].state == "failed" and descents[i].evaluations <= NEW_STARTS:
                descents[i] = self._begun_elsewhere(i, descents[i])
        descents = _merged(descents)
        progress = replace(progress, descents=tuple(descents))
        best = progress.best
        if progress.running or own or best is None:
            return progress
        return _Progress(progress.level + 1, (begin(best.at, FINER_RADIUS),))

    def _squares(self, fit: FitJson, genes: FloatArray) -> SquaredSum:
        per_inside = np.asarray(self.names.per_inside)
        order = places_in_fit(fit, self.names.inside, genes / per_inside)
        return SquaredSum.of(fit, self.logs, order, per_inside)

    def _reason(self, progress: _Progress) -> str:
        best = progress.best
        if best is None:
            return "no start of the fit could be simulated"
        if best.evaluations >= self.settings.evaluations:
            return f"the fit has not converged in {best.evaluations} evaluations"
        return "the fit has converged"


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
    for one in descents:
        near = any(
            other.state in ("running", "converged")
            and other.here is not None
            and float(np.abs(other.trial - one.trial).max()) < SAME_PLACE
            for other in kept
        )
        merged = near and one.state == "running" and one.here is not None
        kept.append(replace(one, state="merged") if merged else one)
    return kept
