"""Holds the result of scoring a blind set, which page, text and console show."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

from service.blind.metrics import Metric
from service.blind.records import CaseRecord
from service.blind.sets import Directions


class Seals(TypedDict):
    """What a score rests on.

    ``manifest`` and ``answers`` are hashes, ``diagnosis`` is the one that answered (see
    `service.blind.sealed_settings`), ``declared`` says why it is not the sealed one, and
    ``directions`` which scans it was shown.
    """

    manifest: str
    answers: str
    diagnosis: dict[str, Any]
    declared: str | None
    directions: Directions


@dataclass(frozen=True)
class ScoredSet:
    """A set with its metrics.

    Parameters
    ----------
    name : str
    records : sequence of CaseRecord
    metrics : sequence of Metric
    floor_mm : float or None
        True gap of the median control; None without controls.
    seals : Seals
    """

    name: str
    records: Sequence[CaseRecord]
    metrics: Sequence[Metric]
    floor_mm: float | None
    seals: Seals

    @property
    def targets_first(self) -> list[Metric]:
        """Return all metrics, those with a target first."""
        return sorted(self.metrics, key=lambda metric: metric.target is None)
