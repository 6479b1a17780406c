"""The searched box: names and bounds of the free parameters."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError

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
