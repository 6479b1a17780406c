"""The result of scoring blind sets, for page, text and console."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

from palpate.service.blind.scoring.metrics import Metric
from palpate.service.blind.sealed.records import CaseRecord
from palpate.service.blind.sealed.sets import Directions


class Seals(TypedDict):
    """The seals behind the score of a set.

    ``set`` is its name, ``manifest`` and ``answers`` are hashes, ``diagnosis`` is the one that
    answered (see `blind.sealed.sealed_settings`), ``declared`` is the reason if it is not the
    sealed one, and ``directions`` are the scans that it received.
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
        Name of the set, or of several: "one + another".
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
        """Return the reasons why the answering diagnosis is not the sealed one, if any."""
        return list(dict.fromkeys(one["declared"] for one in self.seals if one["declared"]))

    @property
    def targets_first(self) -> list[Metric]:
        """Return all metrics, those with a target first."""
        return sorted(self.metrics, key=lambda metric: metric.target is None)
