"""Plausibility checks of studies, cases and imported bodies of any organ."""

from collections.abc import Iterator, Mapping
from typing import Any

from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from palpate.workers.common_keys import CaseSpec, Door, ScoreSpec, TargetSpec
from palpate.workers.mechanics.model_parameters import Bounds
from palpate.workers.organs.organ_plugins import organ_named
from palpate.workers.organs.plausibility_rule import BodyChecks, Finding, accept, checks_of
from palpate.workers.tasks.task_store import BodyStore


def study_findings(
    case: CaseSpec,
    target: TargetSpec,
    score: ScoreSpec,
    store: str,
    *,
    searched: Mapping[str, Bounds],
    elsewhere: bool = False,
) -> Iterator[Finding]:
    """Yield an organ's findings about a study.

    Images are added to the store for the workers. Phantoms are not generated here.

    Parameters
    ----------
    case, target, score
        Specifications, validated by the organ's models.
    store : str
        Location of the store.
    searched : mapping of str to (float, float)
        Searched intervals, in internal names and units.
    elsewhere : bool
        Whether the workers may see files that this process cannot; those are not checked.

    Raises
    ------
    InputError
        If an image is missing or cannot be read.
    """
    checks = checks_of(case.organ, searched)
    if checks is None:
        return
    findings = [*checks.of_case(case), *checks.before_bodies(case, target, score)]
    yield from findings
    if any(finding.severity == "impossible" for finding in findings):
        return
    bodies = BodyStore(open_store(store), organ_named(case.organ))
    reference = _imaged(bodies, case.reference, elsewhere)
    deformed = None if target.constants is not None else _imaged(bodies, target, elsewhere)
    if deformed is not None and reference is not None and target.is_aligned:
        deformed = bodies.organ.aligned(deformed, reference, case)[0]
    yield from checks.of_bodies(case, target, score, reference, deformed)


def _imaged(bodies: BodyStore, spec: Door, elsewhere: bool) -> Any | None:
    """Return a body read from an image; None if it is a phantom or its file is not visible here."""
    files = bodies.organ.body_files(spec)
    if not files:
        return None
    try:
        return bodies.body(bodies.bring_body(spec))
    except InputError:
        if elsewhere and not any(file.exists() for file in files):
            return None
        raise


def imported_findings(organ: str, body: Any, name: str, *, anyway: bool) -> list[Finding]:
    """Check a single body, such as an imported one; `name` is used in messages.

    Several pieces or unlabelled slices are only reported here, but a study of such a body is
    rejected.

    Raises
    ------
    InputError
        If the body cannot be a body of this organ; lists all reasons.
    """
    checks = checks_of(organ)
    found: list[Finding] = (
        list(checks.of_body(body, name)) if isinstance(checks, BodyChecks) else []
    )
    return accept(found, f"The image {name}", anyway=anyway)


def check_case(case: CaseSpec, store: str | None = None, *, anyway: bool = False) -> list[Finding]:
    """Check a case without a target, before anything is made for it.

    Parameters
    ----------
    case : CaseSpec
    store : str, optional
        Store to which its images are added, so that they are checked too.
    anyway : bool
        Whether to accept implausible inputs.

    Raises
    ------
    InputError
        If the case is rejected; lists all reasons.
    """
    found = case_findings(case)
    if store is not None and not any(finding.severity == "impossible" for finding in found):
        bodies = BodyStore(open_store(store), organ_named(case.organ))
        reference = _imaged(bodies, case.reference, False)
        found = found if reference is None else case_findings(case, reference)
    return accept(found, "The case", anyway=anyway)


def case_findings(case: CaseSpec, body: Any | None = None) -> list[Finding]:
    """Return the findings about a case without a target, and about its body if given."""
    checks = checks_of(case.organ, {})
    if checks is None:
        return []
    found: list[Finding] = list(checks.of_case(case))
    return found if body is None else [*found, *checks.of_bodies(case, None, None, body, None)]
