"""The number that a search makes as good as it can: GSF, or another one by name.

A distribution offers an `Objective` as an entry point of the group ``palpate.scores``; a study
chooses it with ``score.objective``.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from palpate.workers.plugins import load
from palpate.workers.spec import DEFAULT_OBJECTIVE

# Candidates whose (1 - JC) MHD is at most a tenth above the best one's are equally good.
EQUALLY_GOOD_GSF = math.log(1.1)
MINIMISED = "objective"

Measure = Callable[[Any], float]


@dataclass(frozen=True, slots=True)
class Objective:
    """A score by which candidates are ranked.

    Parameters
    ----------
    name : str
        Its key in a score, and what a study states under ``score.objective``.
    label : str
        For a reader: ``GSF``.
    direction : {"lower", "higher"}
        Which values are better.
    unit : str
        Of its values; empty for a plain number.
    measure : callable, optional
        From the target to a function of a candidate's deformed body that returns the score.
        Bodies are those of the organ, such as a `Volume` of labels. Without it, the organ's own
        score has a value of that name.
    equally_good : float
        Candidates whose minimised value is at most so far above the best one count as equal to it.
    """

    name: str
    label: str
    direction: Literal["lower", "higher"] = "lower"
    unit: str = ""
    measure: Callable[[Any], Measure] | None = None
    equally_good: float = 0.0

    @property
    def is_default(self) -> bool:
        """Whether the search minimises GSF."""
        return self.name == DEFAULT_OBJECTIVE

    @property
    def axis(self) -> str:
        """The label of an axis of minimised values."""
        sign = "" if self.direction == "lower" else "-"
        unit = f", {self.unit}" if self.unit else ""
        return f"{sign}{self.label}{unit}"

    def minimised(self, value: float) -> float:
        """Return what a search minimises for a value of this score."""
        if math.isnan(value):
            return math.inf
        return value if self.direction == "lower" else -value

    def complete(self, scores: Mapping[str, float], own: float | None) -> dict[str, float]:
        """Return the scores of a candidate with what the search minimises among them.

        Parameters
        ----------
        scores : mapping of str to float
            The organ's own.
        own : float or None
            What `measure` returned; None where there is none.
        """
        if self.is_default:
            return dict(scores)
        value = scores[self.name] if own is None else float(own)
        return {**scores, self.name: value, MINIMISED: self.minimised(value)}

    def text(self, scores: Mapping[str, float], digits: int = 5) -> str:
        """Return the score for a reader: ``GSF -2.1034``."""
        value = scores.get(self.name)
        shown = "-" if value is None else f"{value:.{digits}g}"
        return f"{self.label} {shown} {self.unit}".rstrip()


GSF = Objective(DEFAULT_OBJECTIVE, "GSF", equally_good=EQUALLY_GOOD_GSF)
JACCARD = Objective("jc", "Jaccard coefficient", "higher")
HAUSDORFF = Objective("mhd_mm", "Modified Hausdorff distance", unit="mm")


def objective_named(name: str) -> Objective:
    """Return an objective.

    Raises
    ------
    InputError
        If there is none of that name; close names are suggested.
    """
    found: Objective = load("scores", name)
    return found
