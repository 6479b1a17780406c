"""A search on the logarithms of some parameters."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.service.search.base import Generation, Proposal, Search, Stopped
from palpate.service.search.space import FloatArray, Space
from palpate.storage.errors import InputError


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
