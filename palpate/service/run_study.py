"""The run of a study, shared by the command, Python and the service.

A new study is checked first, palpate.log is written, and the page is written at the end, even after
a failure.
"""

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from palpate.service.cluster.task_dispatch import TaskRunner
from palpate.service.errors_and_interrupts import GenerationCrashError, Interrupted
from palpate.service.report.study.study_page import write_report
from palpate.service.study.loop import Conclusion, Study
from palpate.service.study.preflight import preflight, preflight_task
from palpate.service.study.study_events import logging_to
from palpate.service.study.study_session import Session
from palpate.storage.errors import PalpateError
from palpate.workers.organs.plausibility_rule import Finding, caveats_of

_log = logging.getLogger(__name__)


def write_page(folder: Path, quick: bool) -> None:
    """Write the page of a study; a failure is logged and does not affect the study."""
    try:
        write_report(folder, quick=quick)
    except PalpateError as error:
        _log.warning("The page was not written. %s", error)


@dataclass(frozen=True)
class Entrance:
    """Settings that differ between the command, Python and the service.

    Parameters
    ----------
    anyway : bool
        Run a new study even though its inputs look implausible.
    elsewhere : bool
        The workers are on other machines, which may have access to other files.
    on_a_worker : bool
        Read the images of a new study only on a worker.
    warn : callable
        Receives each warning about a new study.
    shown : context manager
        Shows the progress; entered after the checks.
    write_page : callable
        Writes the page of the study in a folder; quickly if it was interrupted.
    """

    anyway: bool = False
    elsewhere: bool = False
    on_a_worker: bool = False
    warn: Callable[[str], object] = lambda text: None
    shown: AbstractContextManager[object] = field(default_factory=nullcontext)
    write_page: Callable[[Path, bool], object] = write_page


def run_study(
    study: Study, opened: AbstractContextManager[Session[TaskRunner]], entrance: Entrance
) -> Conclusion | None:
    """Run or continue a study.

    Parameters
    ----------
    study : Study
    opened : context manager of Session
        The workers; entered after the checks.
    entrance : Entrance

    Returns
    -------
    Conclusion or None
        None if the study was complete already.

    Raises
    ------
    InputError
        If the inputs of a new study are not valid.
    Interrupted
        If the user asks to stop; completed evaluations are saved.
    PalpateError
        As in `service.study.loop.Study.run`.
    """
    if study.ended:
        return None
    layout = study.folder.layout
    with logging_to(layout.log) as log:
        study.hooks.add(log)
        try:
            conclusion = _checked_run(study, opened, entrance)
        except (Interrupted, KeyboardInterrupt):
            if layout.journal.is_file():
                log.note("interrupted")
                entrance.write_page(study.folder.root, True)
            raise Interrupted from None
        except GenerationCrashError as error:
            text = f"{error} Its traceback is in {layout.log}."
            raise GenerationCrashError(text, error.traceback) from None
        entrance.write_page(study.folder.root, False)
    return conclusion


def _checked_run(
    study: Study, opened: AbstractContextManager[Session[TaskRunner]], entrance: Entrance
) -> Conclusion:
    to_check = not study.begun
    if to_check and not entrance.on_a_worker:
        findings = preflight(
            study.spec, study.store, anyway=entrance.anyway, elsewhere=entrance.elsewhere
        )
        _pass_on(findings, study, entrance)
    with entrance.shown, opened as session:
        if to_check and entrance.on_a_worker:
            asked = study.spec.as_dict(), str(study.store), entrance.anyway
            _pass_on(session.dispatcher.call(preflight_task, *asked), study, entrance)
        for observer in session.observers:
            study.hooks.add(observer)
        return study.run(session.dispatcher, session.dashboard)


def _pass_on(findings: list[Finding], study: Study, entrance: Entrance) -> None:
    study.caveats = caveats_of(findings)
    for finding in findings:
        _log.warning(finding.text)
        entrance.warn(finding.text)
