"""Given candidates with which a search starts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.service.search.operators import Initial
from palpate.service.search.space import FloatArray, Space
from palpate.storage.errors import InputError


@dataclass(frozen=True)
class StartingAt:
    """An initial population whose first candidates are given.

    Parameters
    ----------
    points : tuple of tuple of float
        Genes, one tuple per candidate.
    others : Initial
        Draws the whole population, whose first rows the points replace.
    """

    points: tuple[tuple[float, ...], ...]
    others: Initial

    def __call__(self, rng: np.random.Generator, size: int, space: Space) -> FloatArray:
        """Return the population, shape (size, d)."""
        return with_start(self.others(rng, size, space), self.points)


def with_start(genes: FloatArray, points: Sequence[Sequence[float]]) -> FloatArray:
    """Return genes (n, d) whose first rows are the given points."""
    if not points:
        return genes
    return np.concatenate([np.asarray(points, np.float64), genes[len(points) :]])


def genes_of(points: Sequence[Mapping[str, float]], space: Space) -> tuple[tuple[float, ...], ...]:
    """Return points given by name as genes.

    Raises
    ------
    InputError
        If a point lacks a searched parameter, has an unknown one, or is out of bounds.
    """
    return tuple(_genes(number, point, space) for number, point in enumerate(points, 1))


def _genes(number: int, point: Mapping[str, float], space: Space) -> tuple[float, ...]:
    if set(point) != set(space.names):
        raise InputError(
            f"point {number} of start has {', '.join(point) or 'no values'}; expected one value "
            f"of each searched parameter: {', '.join(space.names)}"
        )
    for name, low, high in zip(space.names, space.lower, space.upper, strict=True):
        if not low <= point[name] <= high:
            raise InputError(
                f"point {number} of start: {name} {point[name]:g} is outside its bounds "
                f"[{low:g}, {high:g}]"
            )
    return tuple(float(point[name]) for name in space.names)
