"""Coordinates for fitting constants: logarithms where a constant cannot be zero."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.service.search.space import FloatArray, Space


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
