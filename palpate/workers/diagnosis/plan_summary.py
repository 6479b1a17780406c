"""Schema of a plan in plain numbers, as printed by `palpate plan --json`.

Frozen dataclasses, used by the report and the commands; `json_digests` writes and reads them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class ParameterPlan:
    """Magnitudes of a parameter, in its unit.

    `minimum` is detected with 80 % power at 1 % false alarms, and None if the parameter is
    invisible; `plausible` is a prior standard deviation. `shown_minimum` and `shown_plausible` are
    the same values in the displayed unit, `shown_unit`; all three are None in records of earlier
    versions.
    """

    parameter: str
    unit: str
    minimum: float | None
    plausible: float
    shown_unit: str | None = None
    shown_minimum: float | None = None
    shown_plausible: float | None = None

    @property
    def shown(self) -> tuple[float | None, float | None, str]:
        """Return the minimum and plausible magnitudes in the displayed unit."""
        if self.shown_unit is None:
            return self.minimum, self.plausible, self.unit
        return self.shown_minimum, self.shown_plausible, self.shown_unit


@dataclass(frozen=True, slots=True)
class PlannedEffect:
    """Detectability of one effect in the planned scans.

    Parameters
    ----------
    name, family, summary : str
    parameters : tuple of ParameterPlan
    absorbed_share : float
        Share of the effect that the constants absorb, 0 to 1.
    nearest : str or None
        The effect with the most similar visible part.
    cosine : float
        Similarity to that effect, 0 to 1.
    log_evidence : float
        Expected log Bayes factor against no gap at the plausible size, in nats.
    seen : bool
        Whether the effect can be named or ruled out.
    why_not : {"hidden", "weak", ""}
    """

    name: str
    family: str
    summary: str
    parameters: tuple[ParameterPlan, ...]
    absorbed_share: float
    nearest: str | None
    cosine: float
    log_evidence: float
    seen: bool
    why_not: Literal["hidden", "weak", ""]


@dataclass(frozen=True, slots=True)
class ConfusablePair:
    """Two visible effects that cannot be distinguished, and the expected log Bayes factor."""

    effects: tuple[str, ...]
    log_evidence: float


@dataclass(frozen=True, slots=True)
class FurtherMeasurement:
    """Expected benefit of one more scan or measurement.

    Parameters
    ----------
    name : str
    told_apart, more_told_apart : int
        Number of distinguishable pairs of effects, in total and gained by the measurement.
    separates : tuple of pairs of str
        Pairs that cannot be distinguished without the measurement.
    reveals, silent : tuple of str
        Effects that are visible only with the measurement, and effects that remain invisible.
    minimum_ratio : float
        Factor by which the minimum detectable magnitudes change; the geometric mean of all effects.
    not_simulated : tuple of str
        Effects that cannot be simulated under the additional load.
    """

    name: str
    told_apart: int
    more_told_apart: int
    separates: tuple[tuple[str, ...], ...]
    reveals: tuple[str, ...]
    silent: tuple[str, ...]
    minimum_ratio: float
    not_simulated: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """A plan in plain numbers.

    Parameters
    ----------
    case : str
    scans : tuple of str
        Names of the planned loads.
    points : int
        Number of points on the interfaces.
    noise_mm : float
        Noise of the segmentation.
    travel_mm : mapping of str to float
        Travel of the plates towards each other, by name of the load.
    named_above, apart_above : float
        Expected log evidence from which an effect is named, and from which it is distinguished from
        another, in nats.
    effects : tuple of PlannedEffect
        Effects that act and could be simulated in all planned scans.
    cosines, log_evidence : tuple of tuple of float
        Similarity of each pair of effects, and expected log Bayes factor of the row's effect
        against the column's effect if the former acts.
    pairs, told_apart : int
        Numbers of pairs of effects and of distinguishable pairs.
    confusable : tuple of ConfusablePair
    silent : tuple of str
        Effects that are invisible.
    not_simulated : tuple of str
        Loads under which the model does not converge.
    loose : tuple of str
        Effects that would push the body away from its supports.
    without_columns : tuple of str
        Effects that do not act here or cannot be simulated.
    acquisitions : tuple of FurtherMeasurement
        Further measurements, the best first.
    caveats : tuple of str, optional
        Caveats shown first, such as a failed plausibility check.
    """

    case: str
    scans: tuple[str, ...]
    points: int
    noise_mm: float
    travel_mm: Mapping[str, float]
    named_above: float
    apart_above: float
    effects: tuple[PlannedEffect, ...]
    cosines: tuple[tuple[float, ...], ...]
    log_evidence: tuple[tuple[float, ...], ...]
    pairs: int
    told_apart: int
    confusable: tuple[ConfusablePair, ...]
    silent: tuple[str, ...]
    not_simulated: tuple[str, ...]
    loose: tuple[str, ...]
    without_columns: tuple[str, ...]
    acquisitions: tuple[FurtherMeasurement, ...]
    caveats: tuple[str, ...] | None = None
