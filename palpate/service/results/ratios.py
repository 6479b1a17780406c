"""Ratios of stiffnesses, which plates at a given distance determine without a force."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

STIFFNESS_UNITS = ("kPa", "Pa")


class Estimate(Protocol):
    """The part of a `service.results.record.ParameterEstimate` used here."""

    @property
    def unit(self) -> str:
        """Return the unit of the numbers."""

    @property
    def estimate(self) -> float | None:
        """Return the best value."""

    @property
    def target(self) -> float | None:
        """Return the true value of a simulated target."""


@dataclass(frozen=True)
class RatioEstimate:
    """The ratio of two stiffnesses.

    Parameters
    ----------
    numerator, denominator : str
        Internal names, such as ``E_glandular`` and ``E_fat``.
    estimate, target : float or None
        As in a `ParameterEstimate`.
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
        """Return ``|estimate - target| / target``; None if either is unknown."""
        if self.estimate is None or not self.target:
            return None
        return abs(self.estimate - self.target) / self.target


def ratio_estimates(estimates: Mapping[str, Estimate]) -> tuple[RatioEstimate, ...]:
    """Return the ratios of the other stiffnesses to the first one that was searched."""
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
