"""What every search shares: its box, its generations, and the coordinates it works in.

A box has the names and bounds of the free parameters. A search is a fold over the finished
generations::

    history = []
    while isinstance(proposal := search.propose(history), Proposal):
        scores = {i: evaluate(proposal.genes[i]) for i in proposal.to_evaluate}
        history.append(proposal.complete(scores, history))

A search keeps no state between two calls. Its proposals are a function of its settings, its
seed and the history, so a study resumed from its journal continues as if it had never
stopped. A candidate is identified by its index in the generation; the order in which scores
arrive is not recorded.

A fit uses the logarithm of every constant that cannot be zero; any other search, of the
parameters that its settings name.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FitJson
from palpate.workers.organs.trust_region_descent import Box

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Space:
    """An axis-aligned box of parameters.

    Parameters
    ----------
    names : sequence of str
        One name per parameter; the order of the genes.
    lower, upper : sequence of float
        Hard bounds, in the unit given by the name; ``lower < upper``, finite.

    Raises
    ------
    InputError
        If there is no parameter, a name is repeated, or a pair of bounds is reversed, equal
        or not finite; the message names the parameter.

    Examples
    --------
    >>> space = Space.from_bounds({"E_fat_kpa": (5, 20), "eta_fat_kpa": (50, 200)})
    >>> space.names
    ('E_fat_kpa', 'eta_fat_kpa')
    >>> space.from_unit(np.array([[0.0, 0.5]])).tolist()
    [[5.0, 125.0]]
    """

    names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "lower", tuple(float(value) for value in self.lower))
        object.__setattr__(self, "upper", tuple(float(value) for value in self.upper))
        if not self.names:
            raise InputError(
                "The search has no parameter. Give at least one under search.parameters, "
                "for example E_fat_kpa: [5, 20]."
            )
        if not len(self.names) == len(self.lower) == len(self.upper):
            raise InputError(
                f"Every parameter needs one lower and one upper bound: got {len(self.names)} "
                f"names, {len(self.lower)} lower and {len(self.upper)} upper bounds."
            )
        _refuse_duplicates(self.names)
        for name, low, high in zip(self.names, self.lower, self.upper, strict=True):
            _check_bounds(name, low, high)

    @classmethod
    def from_bounds(cls, bounds: Mapping[str, Sequence[float]]) -> Self:
        """Build a space from ``{name: (lower, upper)}``, in the order of the mapping."""
        for name, pair in bounds.items():
            if len(pair) != 2:
                raise InputError(
                    f"{name}: expected two bounds [lower, upper], got {len(pair)} numbers."
                )
        return cls(
            tuple(bounds),
            tuple(pair[0] for pair in bounds.values()),
            tuple(pair[1] for pair in bounds.values()),
        )

    @property
    def dimension(self) -> int:
        """Return the number of parameters."""
        return len(self.names)

    @property
    def span(self) -> FloatArray:
        """Return the widths ``upper - lower``, shape (d,)."""
        return np.asarray(self.upper) - np.asarray(self.lower)

    def from_unit(self, unit: FloatArray) -> FloatArray:
        """Map points (n, d) of the unit cube to genes (n, d), clipped to the box."""
        genes = np.asarray(self.lower) + unit * self.span
        return np.clip(genes, self.lower, self.upper)

    def to_unit(self, genes: FloatArray) -> FloatArray:
        """Map genes (n, d) to points (n, d) of the unit cube."""
        return np.asarray((genes - np.asarray(self.lower)) / self.span, dtype=np.float64)

    def as_dict(self, genes: FloatArray) -> dict[str, float]:
        """Return the genes (d,) of one candidate by name."""
        return {name: float(gene) for name, gene in zip(self.names, genes, strict=True)}


def _refuse_duplicates(names: tuple[str, ...]) -> None:
    names_so_far: set[str] = set()
    for name in names:
        if name in names_so_far:
            raise InputError(f"The parameter {name} is listed twice in the search. Remove one.")
        names_so_far.add(name)


def _check_bounds(name: str, low: float, high: float) -> None:
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"{name}: bounds must be finite numbers, got [{low}, {high}].")
    if low == high:
        raise InputError(
            f"{name}: lower and upper bound are both {low:g}, which leaves nothing to search. "
            "Widen the bounds, or give the value under case.constants instead."
        )
    if low > high:
        raise InputError(
            f"{name}: bounds are reversed, got [{low:g}, {high:g}]; expected [lower, upper]. "
            f"Write [{high:g}, {low:g}]."
        )
    if not math.isfinite(high - low):
        raise InputError(f"{name}: the interval [{low:g}, {high:g}] is too wide for floats.")


@dataclass(frozen=True, eq=False)
class Generation:
    """A population with its scores; lower is better.

    Parameters
    ----------
    genes : ndarray, shape (n, d)
        One candidate per row, in the order of the parameter space.
    scores : ndarray, shape (n,)
        ``-inf`` for identical volumes (GSF is a logarithm), ``+inf`` for a failed
        simulation; never NaN.
    fits : tuple of FitJson or None
        The least-squares problem of each candidate, None for a failed one; empty if the
        search needs no derivatives.
    evaluated : int
        Number of candidates evaluated for it; the others were carried over.

    Raises
    ------
    InputError
        If the shapes do not fit together or a score is NaN.
    """

    genes: FloatArray
    scores: FloatArray
    fits: tuple[FitJson | None, ...] = ()
    evaluated: int = 0

    def __post_init__(self) -> None:
        genes, scores = _frozen(self.genes), _frozen(self.scores)
        if genes.ndim != 2 or len(genes) == 0 or scores.shape != (len(genes),):
            raise InputError(
                "A generation needs genes of shape (n, d) and n scores, got shapes "
                f"{genes.shape} and {scores.shape}."
            )
        if np.isnan(scores).any():
            first = int(np.flatnonzero(np.isnan(scores))[0])
            raise InputError(
                f"Candidate {first} has the score NaN, which cannot be ranked. "
                "Report a failed simulation as +inf."
            )
        object.__setattr__(self, "genes", genes)
        object.__setattr__(self, "scores", scores)

    @property
    def ranking(self) -> NDArray[np.intp]:
        """Return candidates from best to worst, shape (n,); ties stay in index order."""
        return np.argsort(self.scores, kind="stable")

    @property
    def best(self) -> int:
        """Return the index of the best candidate."""
        return int(np.argmin(self.scores))


@dataclass(frozen=True, eq=False)
class Proposal:
    """The next population.

    Parameters
    ----------
    genes : ndarray, shape (n, d)
        One candidate per row.
    carried : tuple of int or None, length n
        For an elite, its index in the previous generation, whose score is reused;
        ``None`` for a candidate that needs an evaluation.
    level : int or None
        Index of the coarser resolution used for the evaluation; None for the study's own.
    derivatives : bool
        Whether the search needs the least-squares problem of each candidate.
    """

    genes: FloatArray
    carried: tuple[int | None, ...]
    level: int | None = None
    derivatives: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "genes", _frozen(self.genes))
        if len(self.carried) != len(self.genes):
            raise InputError(
                f"A proposal of {len(self.genes)} candidates needs as many entries in "
                f"`carried`, got {len(self.carried)}."
            )

    @property
    def to_evaluate(self) -> tuple[int, ...]:
        """Return the indices of the candidates that need an evaluation."""
        return tuple(index for index, origin in enumerate(self.carried) if origin is None)

    def complete(
        self,
        scores: Mapping[int, float],
        history: Sequence[Generation],
        fits: Mapping[int, FitJson | None] | None = None,
    ) -> Generation:
        """Build a generation from the scores of the evaluated candidates.

        Parameters
        ----------
        scores : mapping of int to float
            Score by candidate index, in any order, for exactly the indices in `to_evaluate`.
        history : sequence of Generation
            Previous generations; the last one provides the carried scores.
        fits : mapping of int to FitJson or None
            Least-squares problem by candidate index, if derivatives were requested.

        Raises
        ------
        InputError
            If a candidate is missing or unknown.
        """
        expected = set(self.to_evaluate)
        if expected != set(scores):
            missing = sorted(expected - set(scores))
            unknown = sorted(set(scores) - expected)
            raise InputError(
                f"A generation is complete when {len(expected)} candidates have a score; "
                f"missing: {missing}, not requested: {unknown}."
            )
        values = [
            scores[index] if origin is None else history[-1].scores[origin]
            for index, origin in enumerate(self.carried)
        ]
        known = fits or {}
        kept = tuple(known.get(i) for i in self.to_evaluate) if self.derivatives else ()
        return Generation(self.genes, np.asarray(values, dtype=np.float64), kept, len(expected))


@dataclass(frozen=True)
class Stopped:
    """The end of a search and its reason, as text."""

    reason: str


class Search(Protocol):
    """A search strategy."""

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population that follows `history`, or the reason to stop.

        Must be pure: equal arguments give bit-identical results.
        """
        ...


def _frozen(values: FloatArray) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class LogSpace:
    """The coordinates of a box of parameters.

    A coordinate is the logarithm of a parameter with a positive lower bound, and otherwise the
    parameter divided by the width of its interval.

    Parameters
    ----------
    space : Space

    Examples
    --------
    >>> logs = LogSpace(Space.from_bounds({"E_fat_kpa": (5, 20), "friction": (0, 2)}))
    >>> logs.genes(logs.point(np.array([0.5, 0.5]))).round(9).tolist()
    [10.0, 1.0]
    """

    space: Space

    @property
    def logarithmic(self) -> NDArray[np.bool_]:
        """Return a mask of the coordinates that are logarithms, shape (d,)."""
        return np.asarray(self.space.lower) > 0

    @property
    def width(self) -> FloatArray:
        """Return the divisor of each coordinate, 1 for a logarithm, shape (d,)."""
        return np.where(self.logarithmic, 1.0, self.space.span)

    @property
    def lower(self) -> FloatArray:
        """Return the smallest coordinates, shape (d,)."""
        return self.coordinates(np.asarray(self.space.lower))

    @property
    def upper(self) -> FloatArray:
        """Return the largest coordinates, shape (d,)."""
        return self.coordinates(np.asarray(self.space.upper))

    @property
    def box(self) -> Box:
        """Return the smallest and the largest coordinates."""
        return Box(self.lower, self.upper)

    def coordinates(self, genes: FloatArray) -> FloatArray:
        """Return the coordinates of genes, shape (..., d)."""
        logs = np.log(np.where(self.logarithmic, genes, 1.0))
        return np.asarray(np.where(self.logarithmic, logs, genes / self.width))

    def genes(self, coordinates: FloatArray) -> FloatArray:
        """Return the genes at coordinates, shape (..., d), clipped to the box."""
        powers = np.exp(np.where(self.logarithmic, coordinates, 0.0))
        genes = np.where(self.logarithmic, powers, coordinates * self.width)
        return np.clip(genes, self.space.lower, self.space.upper)

    def point(self, unit: FloatArray) -> FloatArray:
        """Return the coordinates of points of the unit cube, shape (..., d)."""
        return np.asarray(self.lower + unit * (self.upper - self.lower))


@dataclass(frozen=True)
class LogScale:
    """A box in which some parameters are searched by their logarithms.

    Parameters
    ----------
    space : Space
        In external units.
    names : frozenset of str
        Parameters with a logarithmic scale; their lower bounds are positive.

    Raises
    ------
    InputError
        If a name is not searched, or its lower bound is not positive.

    Examples
    --------
    >>> scale = LogScale(Space.from_bounds({"E_kpa": (1, 100), "nu": (0.4, 0.5)}), {"E_kpa"})
    >>> middle = (np.add(scale.inner.lower, scale.inner.upper) / 2)[None]
    >>> scale.outer(middle).round(9).tolist()
    [[10.0, 0.45]]
    """

    space: Space
    names: Collection[str]

    def __post_init__(self) -> None:
        for name in self.names:
            if name not in self.space.names:
                raise InputError(f"scale: {name} is not searched")
            if self.space.lower[self.space.names.index(name)] <= 0:
                raise InputError(f"scale: {name} can be zero, which has no logarithm: write linear")

    @property
    def inner(self) -> Space:
        """Return the box in which the search works."""
        low, high = self.to_inner(np.array([self.space.lower, self.space.upper]))
        return Space(self.space.names, tuple(low), tuple(high))

    def to_inner(self, genes: FloatArray) -> FloatArray:
        """Return genes (n, d) on the scales of the search."""
        return np.where(self._is_log, np.log(np.where(self._is_log, genes, 1.0)), genes)

    def outer(self, genes: FloatArray) -> FloatArray:
        """Return genes (n, d) of the search in external units, within the bounds."""
        found = np.where(self._is_log, np.exp(np.where(self._is_log, genes, 0.0)), genes)
        return np.clip(found, self.space.lower, self.space.upper)

    @property
    def _is_log(self) -> FloatArray:
        return np.array([name in self.names for name in self.space.names])


class LogScaledSearch:
    """A `Search` whose inner search uses the scales of `LogScale`.

    Parameters
    ----------
    inner : Search
        A search in the box `LogScale.inner`.
    scale : LogScale
    """

    def __init__(self, inner: Search, scale: LogScale) -> None:
        self.inner, self.scale = inner, scale

    def propose(self, history: Sequence[Generation]) -> Proposal | Stopped:
        """Return the population that follows `history`, or the reason to stop."""
        before = [replace(g, genes=self.scale.to_inner(g.genes)) for g in history]
        proposed = self.inner.propose(before)
        if isinstance(proposed, Stopped):
            return proposed
        genes = self.scale.outer(proposed.genes)
        for row, origin in enumerate(proposed.carried):
            if origin is not None:  # an elite stays bit-identical
                genes[row] = history[-1].genes[origin]
        return replace(proposed, genes=genes)
