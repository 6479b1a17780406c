"""The objective of a search: GSF, or another score by name.

A distribution provides an `Objective` as an entry point in the group ``palpate.scores``; a study
selects it with ``score.objective``.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from palpate.workers.common_keys import DEFAULT_OBJECTIVE
from palpate.workers.plugins import load

# Candidates whose (1 - JC) MHD is at most a tenth above the best count as equally good.
EQUALLY_GOOD_GSF = math.log(1.1)
MINIMISED = "objective"

Measure = Callable[[Any], float]


@dataclass(frozen=True, slots=True)
class Objective:
    """A score that ranks candidates.

    Parameters
    ----------
    name : str
        Key of the objective in a score, and the value of ``score.objective`` in a study file.
    label : str
        Displayed name, such as ``GSF``.
    direction : {"lower", "higher"}
        Whether lower or higher values are better.
    unit : str
        Unit of the values; empty for a plain number.
    measure : callable, optional
        Maps the target to a function that returns the score of a candidate's deformed body. Bodies
        are those of the organ, such as a `Volume` of labels. Without this function, the organ's own
        score must have a value of that name.
    equally_good : float
        Candidates whose minimised value is at most this far above the best count as equally good.
    """

    name: str
    label: str
    direction: Literal["lower", "higher"] = "lower"
    unit: str = ""
    measure: Callable[[Any], Measure] | None = None
    equally_good: float = 0.0

    @property
    def is_default(self) -> bool:
        """True if the search minimises GSF."""
        return self.name == DEFAULT_OBJECTIVE

    @property
    def axis(self) -> str:
        """Axis label for minimised values."""
        sign = "" if self.direction == "lower" else "-"
        unit = f", {self.unit}" if self.unit else ""
        return f"{sign}{self.label}{unit}"

    def minimised(self, value: float) -> float:
        """Return the value that a search minimises for a value of this score."""
        if math.isnan(value):
            return math.inf
        return value if self.direction == "lower" else -value

    def complete(self, scores: Mapping[str, float], own: float | None) -> dict[str, float]:
        """Return the scores of a candidate, including the minimised value.

        Parameters
        ----------
        scores : mapping of str to float
            The organ's own scores.
        own : float or None
            The result of `measure`; None if there is none.
        """
        if self.is_default:
            return dict(scores)
        value = scores[self.name] if own is None else float(own)
        return {**scores, self.name: value, MINIMISED: self.minimised(value)}

    def text(self, scores: Mapping[str, float], digits: int = 5) -> str:
        """Format a score for display, such as ``GSF -2.1034``."""
        value = scores.get(self.name)
        shown = "-" if value is None else f"{value:.{digits}g}"
        return f"{self.label} {shown} {self.unit}".rstrip()


GSF = Objective(DEFAULT_OBJECTIVE, "GSF", equally_good=EQUALLY_GOOD_GSF)
JACCARD = Objective("jc", "Jaccard coefficient", "higher")
HAUSDORFF = Objective("mhd_mm", "Modified Hausdorff distance", unit="mm")


def objective_named(name: str) -> Objective:
    """Return the objective with this name.

    Raises
    ------
    InputError
        If the name is unknown; similar names are suggested.
    """
    found: Objective = load("scores", name)
    return found
