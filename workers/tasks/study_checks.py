"""Looks at the bodies of a study before its first task, where they are at hand."""

from collections.abc import Iterator
from typing import Any

from storage.errors import InputError
from storage.stores import open_store
from workers.organs.registry import organ_named
from workers.organs.study_checks import Finding, checks_of
from workers.spec import CaseSpec, Door, ScoreSpec, TargetSpec
from workers.tasks.body_store import BodyStore


def study_findings(
    case: CaseSpec, target: TargetSpec, score: ScoreSpec, store: str, *, elsewhere: bool = False
) -> Iterator[Finding]:
    """Yield what an organ finds wrong with a study.

    Images come into the store on the way, where the workers find them. A body that is
    generated is not made here.

    Parameters
    ----------
    case, target, score
        As the organ understands them.
    store : str
        Where the store is.
    elsewhere : bool
        The workers may see files that this process does not: those are left to them.

    Raises
    ------
    InputError
        If an image is missing or cannot be read.
    """
    checks = checks_of(case.organ)
    if checks is None:
        return
    findings = [*checks.of_case(case), *checks.before_bodies(case, target, score)]
    yield from findings
    if any(finding.severity == "impossible" for finding in findings):
        return
    bodies = BodyStore(open_store(store), organ_named(case.organ))
    reference = _imaged(bodies, case.reference, elsewhere)
    deformed = None if target.constants is not None else _imaged(bodies, target, elsewhere)
    yield from checks.of_bodies(case, target, score, reference, deformed)


def _imaged(bodies: BodyStore, spec: Door, elsewhere: bool) -> Any | None:
    """Return a body that comes from an image; None if it is generated or cannot be seen here."""
    files = bodies.organ.body_files(spec)
    if not files:
        return None
    try:
        return bodies.body(bodies.bring_body(spec))
    except InputError:
        if elsewhere and not any(file.exists() for file in files):
            return None
        raise


def check_case(case: CaseSpec) -> None:
    """Refuse a case that cannot be simulated, before anything is made for it.

    Raises
    ------
    InputError
        With the reason.
    """
    checks = checks_of(case.organ)
    for finding in checks.of_case(case) if checks is not None else ():
        if finding.severity == "impossible":
            raise InputError(finding.text)
