"""Ratios of stiffnesses: what plates at a distance can tell when no stiffness is held."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

STIFFNESS_UNITS = ("kPa", "Pa")


class Estimate(Protocol):
    """What is read of a `service.results.record.ParameterEstimate`."""

    @property
    def unit(self) -> str:
        """The unit of the numbers."""

    @property
    def estimate(self) -> float | None:
        """The best value."""

    @property
    def target(self) -> float | None:
        """The true value of a simulated target."""


@dataclass(frozen=True)
class RatioEstimate:
    """A stiffness over another one.

    Parameters
    ----------
    numerator, denominator : str
        Their names inside, such as ``E_glandular`` and ``E_fat``.
    estimate, target : float or None
        As of a `ParameterEstimate`.
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
        """Return ``|estimate - target| / target``; None where one of them is not known."""
        if self.estimate is None or not self.target:
            return None
        return abs(self.estimate - self.target) / self.target


def ratio_estimates(estimates: Mapping[str, Estimate]) -> tuple[RatioEstimate, ...]:
    """Return the other stiffnesses over the first one that was searched."""
    stiff = [(name, e) for name, e in estimates.items() if e.unit in STIFFNESS_UNITS]
    if not stiff:
        return ()
    (base, below), *others = stiff
    return tuple(
        RatioEstimate(
            name,
            base,
            _divided(e.estimate, below.estimate),
            _divided(e.target, below.target),
        )
        for name, e in others
    )


def _divided(above: float | None, below: float | None) -> float | None:
    return None if above is None or not below else above / below
