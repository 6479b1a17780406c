"""Holds the result of scoring blind sets, which page, text and console show."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

from palpate.service.blind.scoring.metrics import Metric
from palpate.service.blind.sealed.records import CaseRecord
from palpate.service.blind.sealed.sets import Directions


class Seals(TypedDict):
    """What the score of a set rests on.

    ``set`` is its name, ``manifest`` and ``answers`` are hashes, ``diagnosis`` is the one that
    answered (see `blind.sealed.sealed_settings`), ``declared`` says why it is not the sealed
    one, and ``directions`` which scans it was shown.
    """

    set: str
    manifest: str
    answers: str
    diagnosis: dict[str, Any]
    declared: str | None
    directions: Directions


@dataclass(frozen=True)
class ScoredSet:
    """One set, or several together, with metrics.

    Parameters
    ----------
    name : str
        Of the set, or of all of them: "one + another".
    records : sequence of CaseRecord
    metrics : sequence of Metric
    floor_mm : float or None
        True gap of the median control; None without controls.
    seals : tuple of Seals
        One for each set.
    """

    name: str
    records: Sequence[CaseRecord]
    metrics: Sequence[Metric]
    floor_mm: float | None
    seals: tuple[Seals, ...]

    @property
    def declared(self) -> list[str]:
        """Return why the diagnosis that answered is not the sealed one, where it is not."""
        return list(dict.fromkeys(one["declared"] for one in self.seals if one["declared"]))

    @property
    def targets_first(self) -> list[Metric]:
        """Return all metrics, those with a target first."""
        return sorted(self.metrics, key=lambda metric: metric.target is None)
