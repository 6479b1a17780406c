"""What an organ can say of a study before anything is simulated, by organ.

A module of checks is imported when it is first asked for, so no result depends on its code.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, Protocol

# The module of each organ that has checks of its own; it holds the object CHECKS.
MODULES = {"breast": "workers.organs.breast.study_checks"}


@dataclass(frozen=True, slots=True)
class Finding:
    """Something about a study that its user should know before it runs.

    Parameters
    ----------
    severity : {"warning", "implausible", "impossible"}
        Whether the study runs all the same, runs if its user insists, or cannot run.
    text : str
        What was found, what was expected and what to do.
    """

    severity: Literal["warning", "implausible", "impossible"]
    text: str


class StudyChecks(Protocol):
    """The checks of one organ; bodies that are not at hand are None."""

    def of_case(self, case: Any) -> Iterator[Finding]:
        """Yield what can be said of a case without its body."""

    def before_bodies(self, case: Any, target: Any, score: Any) -> Iterator[Finding]:
        """Yield what else can be said of the study file alone."""

    def of_bodies(
        self, case: Any, target: Any, score: Any, reference: Any | None, deformed: Any | None
    ) -> Iterator[Finding]:
        """Yield what the undeformed body and an imaged target show."""


def checks_of(organ: str) -> StudyChecks | None:
    """Return the checks of an organ; None if it has none of its own."""
    if organ not in MODULES:
        return None
    checks: StudyChecks = import_module(MODULES[organ]).CHECKS
    return checks
