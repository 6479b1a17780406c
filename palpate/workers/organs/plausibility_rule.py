"""Plausibility checks of an organ, by name, and the rule for refusing input.

A module of checks is imported on first use, so no result depends on its code.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

from palpate.storage.errors import InputError
from palpate.workers.mechanics.model_parameters import Bounds
from palpate.workers.organs.organ_plugins import organ_plugin, resolve

ANYWAY = "If the input is right as it is, continue with --anyway (in Python: anyway=True)."
FIRST_LINE = "Computed with --anyway, although a plausibility check failed: "


@dataclass(frozen=True, slots=True)
class Finding:
    """A fact about an input that its user should know before anything is computed.

    Parameters
    ----------
    severity : {"warning", "implausible", "impossible"}
        Whether the computation goes on, goes on if its user insists, or cannot be done.
    text : str
        What was found, what was expected and what to do.
    """

    severity: Literal["warning", "implausible", "impossible"]
    text: str

    def __str__(self) -> str:
        return self.text


class StudyChecks(Protocol):
    """The checks of one organ; unavailable bodies are None."""

    def of_case(self, case: Any) -> Iterator[Finding]:
        """Check a case without its body."""

    def before_bodies(self, case: Any, target: Any, score: Any) -> Iterator[Finding]:
        """Check the rest of the study file."""

    def of_bodies(
        self, case: Any, target: Any, score: Any, reference: Any | None, deformed: Any | None
    ) -> Iterator[Finding]:
        """Check the undeformed body and an imaged target."""


@runtime_checkable
class BodyChecks(Protocol):
    """The checks of an organ whose bodies can be imported."""

    def of_body(self, body: Any, name: str) -> Iterator[Finding]:
        """Check one body on its own; `name` is used in messages."""


@runtime_checkable
class SearchChecks(Protocol):
    """The checks of an organ that depend on the searched intervals."""

    def with_search(self, searched: Mapping[str, Bounds]) -> StudyChecks:
        """Return the checks of a study that searches these intervals, internal names and units."""


@runtime_checkable
class CheckedSource(Protocol):
    """A source of a diagnosis that has plausibility checks."""

    def findings(self) -> Iterator[Finding]:
        """Check the scans and loads."""

    @property
    def caveats(self) -> tuple[str, ...]:
        """Statements shown first in every result of this source."""


def checks_of(organ: str, searched: Mapping[str, Bounds] | None = None) -> StudyChecks | None:
    """Return the checks of an organ, of a study that searches these intervals if any are given.

    None if the organ has no checks of its own.
    """
    name = organ_plugin(organ).checks
    checks: StudyChecks | None = resolve(name) if name else None
    if searched is not None and isinstance(checks, SearchChecks):
        return checks.with_search(searched)
    return checks


def refused(findings: Iterable[Finding], anyway: bool) -> list[Finding]:
    """Return the findings that prevent a computation."""
    accepted = {"warning", "implausible"} if anyway else {"warning"}
    return [finding for finding in findings if finding.severity not in accepted]


def accept(findings: Iterable[Finding], what: str, *, anyway: bool) -> list[Finding]:
    """Return the findings of an accepted input.

    Parameters
    ----------
    findings : iterable of Finding
    what : str
        The input, as the subject of a sentence: ``The study demo``.
    anyway : bool
        Whether the user insists on an input that looks implausible.

    Raises
    ------
    InputError
        With every reason, if the input is refused.
    """
    all_findings = list(findings)
    reasons = refused(all_findings, anyway)
    if reasons:
        text = "\n".join(f"  {finding.text}" for finding in reasons)
        insist = all(finding.severity == "implausible" for finding in reasons)
        raise InputError(
            f"{what} did not pass the plausibility checks:\n{text}"
            + (f"\n{ANYWAY}" if insist else "")
        )
    return all_findings


def caveats_of(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the statements shown first in results computed with --anyway."""
    insisted = (finding for finding in findings if finding.severity == "implausible")
    return tuple(f"{FIRST_LINE}{finding.text}" for finding in insisted)
