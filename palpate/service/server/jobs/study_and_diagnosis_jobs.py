"""One queued study, and one queued diagnosis: how each is run.

The steps of a diagnosis are journalled like the endings of a study.
"""

import logging
import subprocess
import time
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from palpate.service.cluster.task_dispatch import Dispatcher, TaskRunner
from palpate.service.diagnosis.diagnosis_run import (
    Step,
    finished,
    request_for,
    run_and_tell,
    with_caveats,
)
from palpate.service.report.diagnosis.diagnosis_page import write_diagnosis
from palpate.service.report.study.page_provenance import Origin, origin_of
from palpate.service.run_study import Entrance, run_study
from palpate.service.server.jobs.home_and_tokens import helper_command, helper_environment
from palpate.service.study.loop import Study
from palpate.service.study.study_keys import StudySpec
from palpate.service.study.study_session import Session
from palpate.service.study.task_requests import Tasks
from palpate.storage.backends.atomic_files import explained
from palpate.storage.backends.store_paths import Location, StudyLayout
from palpate.storage.errors import InputError
from palpate.storage.journal import Journal
from palpate.storage.journal_records import SCHEMA_VERSION
from palpate.workers.common_keys import validated
from palpate.workers.input_files import confined_to
from palpate.workers.mechanics.model_parameters import unknown_name
from palpate.workers.tasks.diagnosis_sources import check_source, open_source, source_caveats
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest

_log = logging.getLogger(__name__)

REPORT_S = 900.0


class ReportError(Exception):
    """An error in writing the page of a study; the study itself is complete."""


def study_request(spec: StudySpec, accept_new_code: bool, anyway: bool = False) -> dict[str, Any]:
    """Return the request of a study for the queue."""
    return {
        "name": spec.name,
        "spec": spec.as_dict(),
        "accept_new_code": accept_new_code,
        "anyway": anyway,
        "most_evaluations": spec.most_evaluations,
        "most_generations": spec.most_generations,
    }


def run_queued_study(
    request: Mapping[str, Any],
    folder: Path,
    store: Location,
    session: Session[TaskRunner],
    tasks: Tasks | None = None,
    *,
    reports: bool = True,
) -> None:
    """Run or continue a queued study.

    Parameters
    ----------
    request : mapping
        See `study_request`.
    folder : Path
    store : str or Path
    session : Session
    tasks : Tasks, optional
    reports : bool
        Write the page at the end, unless it exists.

    Raises
    ------
    PalpateError, Interrupted
        As in `service.run_study.run_study`.
    ReportError
        If the study has ended but its page could not be written.
    """
    spec = validated(StudySpec, request["spec"], "The study")
    accept = bool(request.get("accept_new_code"))
    study = Study(spec, folder, store, tasks=tasks, accept_new_code=accept)
    page = write_report if reports else _no_page
    entrance = Entrance(anyway=bool(request.get("anyway")), on_a_worker=True, write_page=page)
    if run_study(study, nullcontext(session), entrance) is None:
        page(folder, False)


def _no_page(folder: Path, quick: bool) -> None:
    """Skip the page."""


def write_report(folder: Path, quick: bool) -> None:
    """Write the page of a completed study in a separate process, unless it exists.

    A stopped study has the service's live page.

    Raises
    ------
    ReportError
        If it fails, which does not affect the study.
    """
    if quick or StudyLayout(folder).report.exists():
        return
    try:
        ended = subprocess.run(
            helper_command("palpate", "report", str(folder)),
            env=helper_environment(),
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=REPORT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ReportError(f"it was not finished after {REPORT_S:.0f} s") from None
    if ended.returncode != 0:
        lines = ended.stderr.decode(errors="replace").strip().splitlines()
        _log.error("The page of %s could not be written: %s", folder, "\n".join(lines))
        raise ReportError(
            lines[-1] if lines else f"its process ended with exit code {ended.returncode}"
        )


def bring_source(
    path: str,
    store: str,
    nodes: int,
    effects: tuple[str, ...] | None,
    when: str,
    anyway: bool = False,
    within: str | None = None,
) -> tuple[DiagnosisRequest, Origin, tuple[str, ...]]:
    """Read the source into the store, in a task, so a damaged image affects only a worker.

    An upload may only name files in its folder `within`.

    Raises
    ------
    InputError
        If the source cannot be diagnosed, or an effect is not in its catalogue.
    """
    with nullcontext() if within is None else confined_to(Path(within)):
        opened = open_source(Path(path), store)
    known = [effect.name for effect in opened.effects]
    for name in effects or ():
        if name not in known:
            raise InputError(unknown_name("effect", name, known))
    caveats = source_caveats(opened, check_source(opened, anyway=anyway))
    request = request_for(opened, store, nodes, effects=effects)
    return request, origin_of(opened, request, when, "", None), caveats


def run_queued_diagnosis(
    request: Mapping[str, Any], source: Path, folder: Path, store: Location, dispatcher: Dispatcher
) -> None:
    """Run or resume a diagnosis; write its page and record to `folder`.

    Raises
    ------
    PalpateError, Interrupted
        As in `service.diagnosis.diagnosis_run.run_diagnosis`.
    """
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    effects = request.get("effects")
    named = None if effects is None else tuple(dict.fromkeys(effects))
    began, when = time.monotonic(), datetime.now(UTC).isoformat(timespec="seconds")
    with Journal(StudyLayout(folder).journal) as journal:

        def append(kind: str, **values: Any) -> None:
            journal.append({"kind": kind, "schema_version": SCHEMA_VERSION} | values)

        def observe(step: Step) -> None:
            append("step", phase=step.phase, done=step.done, of=step.of, task=step.task)

        append("session", began=when)
        anyway = bool(request.get("anyway"))
        within = str(source if source.is_dir() else source.parent)
        asked, origin, caveats = dispatcher.call(
            bring_source,
            str(source),
            str(store),
            request["nodes"],
            named,
            when,
            anyway,
            within if request["source"].get("upload") else None,
        )
        stored = finished(asked) is not None
        diagnosis = with_caveats(run_and_tell(asked, dispatcher, folder, observe), caveats)
        spent = None if stored else time.monotonic() - began
        write_diagnosis(
            diagnosis, folder, replace(origin, made=replace(origin.made, seconds=spent))
        )
        append("end", reason="all computed", verdict=diagnosis.summary.verdict)
