"""The schema of a plan in plain numbers: what `palpate plan --json` prints.

Frozen dataclasses, read by the report and the commands; `records.typed_json` writes them and
reads them again.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class ParameterPlan:
    """Magnitudes of a parameter in its unit.

    `minimum` is found with 80 % power at 1 % false alarms, None where nothing is visible;
    `plausible` is a prior standard deviation. `shown_minimum` and `shown_plausible` are the same
    as a reader thinks of them, in `shown_unit`; None in records of earlier versions.
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
        """Return least and plausible magnitude and their unit, for a reader."""
        if self.shown_unit is None:
            return self.minimum, self.plausible, self.unit
        return self.shown_minimum, self.shown_plausible, self.shown_unit


@dataclass(frozen=True, slots=True)
class PlannedEffect:
    """What the planned scans could show of one effect.

    Parameters
    ----------
    name, family, summary : str
    parameters : tuple of ParameterPlan
    absorbed_share : float
        What the constants hide of it, 0 to 1.
    nearest : str or None
        The effect whose visible part looks most alike.
    cosine : float
        How alike, 0 to 1.
    log_evidence : float
        Expected over no gap if it acts at its plausible size, in nats.
    seen : bool
        Whether it can be accused or acquitted.
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
    """Two effects that are seen and not told apart; the log evidence expected between them."""

    effects: tuple[str, ...]
    log_evidence: float


@dataclass(frozen=True, slots=True)
class FurtherMeasurement:
    """What one more scan or measurement would add.

    Parameters
    ----------
    name : str
    told_apart, more_told_apart : int
        Pairs of effects, in all and in addition.
    separates : tuple of pairs of str
        Pairs that are confusable without it.
    reveals, silent : tuple of str
        Effects that are seen with it only, and those that are still not seen.
    minimum_ratio : float
        Geometric mean of `minimum_ratios`.
    minimum_ratios : mapping of str to float
        By which the smallest magnitude of each effect changes that is found.
    absorbed_shares : mapping of str to float
    not_simulated : tuple of str
        Effects that cannot be simulated under it.
    """

    name: str
    told_apart: int
    more_told_apart: int
    separates: tuple[tuple[str, ...], ...]
    reveals: tuple[str, ...]
    silent: tuple[str, ...]
    minimum_ratio: float
    minimum_ratios: Mapping[str, float]
    absorbed_shares: Mapping[str, float]
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
        On the interfaces.
    noise_mm : float
        Of the segmentation.
    travel_mm : mapping of str to float
        By how much plates come closer, by the name of the load.
    clear : float
        Log evidence that decides, in nats.
    effects : tuple of PlannedEffect
        Those that act and could be simulated in all planned scans.
    cosines, log_evidence : tuple of tuple of float
        How alike two effects look, and by how much the one of the row, acting, beats the one
        of the column.
    pairs, told_apart : int
        Pairs of effects, and those that are told apart.
    confusable : tuple of ConfusablePair
    silent : tuple of str
        Effects that are not seen.
    not_simulated : tuple of str
        Loads at which the model does not converge.
    loose : tuple of str
        Effects that would push the body away.
    without_columns : tuple of str
        Effects that do not act here or cannot be simulated.
    acquisitions : tuple of FurtherMeasurement
        The best first.
    caveats : tuple of str, optional
        Statements with which the plan begins, such as a plausibility check that failed.
    """

    case: str
    scans: tuple[str, ...]
    points: int
    noise_mm: float
    travel_mm: Mapping[str, float]
    clear: float
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
